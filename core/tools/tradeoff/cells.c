#include "core/tools/tradeoff/cells.h"

#include <math.h>
#include <stdlib.h>

#include "core/kernels.h"

/* Each side of a cell has this many steps, and a medium at each end of a step. The ratios of the
 * first cells have more: they begin at 0, and between 0 and 1e-4 the error of Burley's profile for
 * the diffuse mean free path rises and falls again. */
enum { STEPS = 2, POINTS = STEPS + 1, STEPS_FROM_0 = 8 };

/* `transport` looks a medium up in its table of solutions if this much is accepted. */
#define LOOK_UP_TOLERANCE 1e-4
#define MEDIUM_COST_US 2500.0 /* estimated work, for the progress bar only */

const double cells_gs[CELLS_GS + 1] = {-0.5, -0.25, 0, 0.25, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95};
const double cells_ratios[CELLS_RATIOS + 1] = {0,    1e-4, 1e-3, 3e-3, 0.01, 0.02, 0.04,
                                               0.06, 0.1,  0.16, 0.25, 0.4,  0.63, 1,
                                               1.6,  2.5,  4,    6.3,  10};
const double cells_etas[CELLS_ETAS + 1] = {1, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6, 1.8, 2};

/* Only the first cells begin at 0. */
enum {
  MEDIA = (CELLS_RATIOS * POINTS + STEPS_FROM_0 - STEPS) * CELLS_ETAS * CELLS_GS * POINTS * POINTS
};

double cells_cost_us(void) {
  return MEDIA * MEDIUM_COST_US;
}

errors_node *cells_at(errors_node *cells, size_t model, size_t g, size_t ratio, size_t eta) {
  return &cells[((model * CELLS_GS + g) * CELLS_RATIOS + ratio) * CELLS_ETAS + eta];
}

/* ---- media ----------------------------------------------------------------------------------- */

/* Returns point i of the cell between two edges. */
static double point_of(const double *edges, size_t cell, size_t i) {
  const double share = (double)i / STEPS;
  return i == STEPS ? edges[cell + 1] : edges[cell] + share * (edges[cell + 1] - edges[cell]);
}

static size_t ratio_steps(size_t cell) {
  return cells_ratios[cell] > 0 ? STEPS : STEPS_FROM_0;
}

/* The same for ratios, which have equal steps of the logarithm, or, from 0 on, of the fourth root.
 */
static double ratio_of(size_t cell, size_t i) {
  const double first = cells_ratios[cell], last = cells_ratios[cell + 1];
  const size_t steps = ratio_steps(cell);
  const double share = (double)i / (double)steps;
  return i == 0       ? first
         : i == steps ? last
         : first > 0  ? first * pow(last / first, share)
                      : last * (share * share) * (share * share);
}

static core_medium medium_of(double g, double ratio, double eta) {
  return (core_medium){ratio / (1 + ratio), 1 / (1 + ratio) / (1 - g), g, eta};
}

/* ---- one medium ------------------------------------------------------------------------------ */

/* The values of a profile, in 1/mm^2 with sigma_t' = 1 per mm. */
struct values {
  bool known;
  double R[NODES_RADII];
  double albedo;
};

/* What transport says of a medium, and its own errors. */
struct truth {
  struct values values;
  double band_error[NODES_BANDS];
  double albedo_error;
};

static void evaluate(struct values *values, const core_profile *profile) {
  double r[NODES_RADII];
  nodes_radii(r);
  core_eval_f64(profile, CORE_QUANTITY_R, NODES_RADII, r, values->R);
  values->albedo = profile->albedo;
  values->known = true;
}

static void find_truth(struct truth *truth, const core_medium *medium) {
  core_parameters parameters = core_parameters_none();
  core_profile profile;
  parameters.value[CORE_PARAMETER_TOLERANCE] = LOOK_UP_TOLERANCE;
  truth->values.known = false;
  if (!core_transport_is_stored(medium) ||
      core_profile_prepare(&profile, core_isa_select(NULL), CORE_MODEL_TRANSPORT,
                           CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, medium, &parameters)
              .field != NULL) {
    return;
  }
  evaluate(&truth->values, &profile);
  for (size_t band = 0; band < NODES_BANDS; band++) {
    const core_radii_range radii = {nodes_edges[band], nodes_edges[band + 1]};
    truth->band_error[band] = core_profile_errors(&profile, CORE_QUANTITY_R, radii).numerical;
  }
  truth->albedo_error =
      core_profile_errors(&profile, CORE_QUANTITY_ALBEDO, (core_radii_range){0, 0}).numerical;
  core_profile_free(&profile);
}

static void find_values(struct values *values, const subjects *of, const subject *one,
                        const core_medium *medium) {
  core_profile profile;
  values->known = subjects_prepare(&profile, of, one, medium, (double)NAN).field == NULL;
  if (values->known) {
    evaluate(values, &profile);
    core_profile_free(&profile);
  }
}

/* Returns |value / truth - 1| for any truth within the relative error of the one given. */
static double deviation(double value, double truth, double error) {
  return (1 + fabs(value / truth - 1)) / (1 - error) - 1;
}

/* Raises the errors of a cell to those of a medium in it. */
static void compare(errors_node *cell, const struct values *values, const struct truth *truth) {
  const bool known = values->known && truth->values.known;
  for (size_t band = 0; band < NODES_BANDS; band++) {
    double worst = known ? 0 : (double)INFINITY;
    for (size_t i = nodes_band_start(band); known && i <= nodes_band_start(band + 1); i++) {
      worst = fmax(worst, deviation(values->R[i], truth->values.R[i], truth->band_error[band]));
    }
    cell->worst[band] = fmax(cell->worst[band], worst);
  }
  cell->albedo = fmax(cell->albedo,
                      known ? deviation(values->albedo, truth->values.albedo, truth->albedo_error)
                            : (double)INFINITY);
}

/* ---- all of them ----------------------------------------------------------------------------- */

struct campaign {
  const subjects *of;
  errors_node *cells;
  tools_progress *progress;
};

/* Compares all models with transport at all g of one ratio and eta. Models that see sigma_s (1 - g)
 * alone are evaluated once. */
static void measure_column(const struct campaign *all, size_t ratio, size_t eta, double at_ratio,
                           double at_eta) {
  static _Thread_local struct values similar[SUBJECTS_MODELS_MAX];
  const subjects *of = all->of;
  const core_medium isotropic = medium_of(0, at_ratio, at_eta);
  for (size_t s = 0; s < of->count; s++) {
    if (of->all[s].evaluator->id == CORE_EVALUATOR_F64 && of->models[of->all[s].model].similarity) {
      find_values(&similar[of->all[s].model], of, &of->all[s], &isotropic);
    }
  }
  for (size_t g = 0; g < CELLS_GS; g++) {
    for (size_t i = 0; i < POINTS; i++) {
      const core_medium medium = medium_of(point_of(cells_gs, g, i), at_ratio, at_eta);
      struct truth truth;
      find_truth(&truth, &medium);
      for (size_t s = 0; s < of->count; s++) {
        const subject *one = &of->all[s];
        const bool is_similar = of->models[one->model].similarity;
        struct values own;
        if (one->evaluator->id != CORE_EVALUATOR_F64 ||
            of->models[one->model].model->id == CORE_MODEL_TRANSPORT) {
          continue;
        }
        if (!is_similar) {
          find_values(&own, of, one, &medium);
        }
        compare(cells_at(all->cells, one->model, g, ratio, eta),
                is_similar ? &similar[one->model] : &own, &truth);
      }
    }
  }
}

/* Measures the cells of one ratio and eta, which no other thread writes. */
static void measure(void *context, size_t index) {
  const struct campaign *all = context;
  const size_t ratio = index / CELLS_ETAS, eta = index % CELLS_ETAS;
  for (size_t i = 0; i <= ratio_steps(ratio); i++) {
    for (size_t k = 0; k < POINTS; k++) {
      measure_column(all, ratio, eta, ratio_of(ratio, i), point_of(cells_etas, eta, k));
      tools_progress_add(all->progress, CELLS_GS * POINTS * MEDIUM_COST_US);
    }
  }
}

errors_node *cells_measure(const subjects *of, size_t threads, tools_progress *progress) {
  struct campaign all = {.of = of, .progress = progress};
  all.cells = calloc(of->model_count * CELLS_GS * CELLS_RATIOS * CELLS_ETAS, sizeof *all.cells);
  if (all.cells == NULL) {
    tools_fail("out of memory");
  }
  tools_progress_stage(progress, "errors, anisotropic scattering");
  tools_each(threads, CELLS_RATIOS * CELLS_ETAS, measure, &all);
  return all.cells;
}
