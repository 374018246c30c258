/* model-errors TRANSPORT.CSV: measures how far every model is from radiative transport and prints
 * core/model_errors.def; core/model_error.h says what its numbers mean.
 *
 * TRANSPORT.CSV has a header and the columns ratio, eta, albedo_ss, total, r, R, single, multiple,
 * error: exact solutions for isotropic scattering, in mean free paths. Anisotropic scattering is
 * compared by Monte Carlo with fixed seeds, so that the same file comes out on every machine. It
 * takes a few minutes.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "core/core.h"
#include "core/montecarlo/montecarlo.h"

enum { ROWS_MAX = 4096, RATIOS = 16, ETAS = 4, G_RATIOS = 5, G_ETAS = 3, RINGS = 24 };

#define R_LEAST 0.1
#define R_MOST 20.0

struct row {
  double ratio, eta, albedo, r, R;
};

static struct row rows[ROWS_MAX];
static size_t row_count;

static void fail(const char *what) {
  fprintf(stderr, "model-errors: %s\n", what);
  exit(EXIT_FAILURE);
}

static void read_rows(const char *path) {
  char line[512];
  FILE *file = fopen(path, "r");
  if (file == NULL) {
    fail("cannot read the file of exact solutions");
  }
  while (fgets(line, sizeof line, file) != NULL && row_count < ROWS_MAX) {
    struct row *row = &rows[row_count];
    double total;
    if (sscanf(line, "%lf,%lf,%lf,%lf,%lf,%lf", &row->ratio, &row->eta, &row->albedo, &total,
               &row->r, &row->R) == 6) {
      row_count++;
    }
  }
  fclose(file);
}

/* ---- isotropic scattering ---------------------------------------------------------------------
 */

/* Rows of one medium follow each other; false: the model needs more than a medium. */
static bool deviation(unsigned model, size_t first, size_t last, double *worst) {
  const core_medium medium = {1 - rows[first].albedo, rows[first].albedo, 0, rows[first].eta};
  core_profile profile;
  *worst = 0;
  if (core_profile_prepare(&profile, core_isa_select(NULL), model, CORE_MOMENTS_EXACT,
                           CORE_EVALUATOR_F64, &medium, NULL)
          .field != NULL) {
    return false;
  }
  const bool fixed = (profile.notes & CORE_NOTE_MEDIUM_UNUSED) != 0;
  for (size_t i = first; i < last && !fixed; i++) {
    double R;
    core_eval_f64(&profile, CORE_QUANTITY_R, 1, &rows[i].r, &R);
    if (rows[i].r >= R_LEAST && rows[i].r <= R_MOST) {
      *worst = fmax(*worst, fabs(R / rows[i].R - 1));
    }
  }
  core_profile_free(&profile);
  return !fixed;
}

/* Up, with three digits. */
static void print_error(double error) {
  if (isnan(error)) {
    printf("NAN");
    return;
  }
  const double unit = error > 0 ? pow(10, floor(log10(error)) - 2) : 1;
  printf("%.3g", ceil(error / unit * (1 - 1e-12)) * unit);
}

static void print_isotropic(const core_choice *model) {
  double worst[RATIOS * ETAS];
  size_t media = 0;
  /* A fit is as far off as what it is fitted to; transport is what the others are measured by. */
  if (model->id == CORE_MODEL_GAUSSIANS || model->id == CORE_MODEL_TRANSPORT) {
    return;
  }
  for (size_t first = 0, last = 0; first < row_count; first = last) {
    while (last < row_count && rows[last].ratio == rows[first].ratio &&
           rows[last].eta == rows[first].eta) {
      last++;
    }
    if (media == RATIOS * ETAS || !deviation(model->id, first, last, &worst[media++])) {
      return;
    }
  }
  if (media != RATIOS * ETAS) {
    fail("the file does not hold sixteen ratios times four eta");
  }
  printf("/* %s */\nISOTROPIC(%u", model->name, model->id);
  for (size_t i = 0; i < media; i++) {
    printf(i % ETAS == 0 ? ",\n          {" : ", ");
    print_error(worst[i]);
    printf(i % ETAS == ETAS - 1 ? "}" : "");
  }
  printf(")\n");
}

/* ---- the similarity relation ------------------------------------------------------------------
 */

/* sigma_t' = 1 per mm. */
static void walk(double ratio, double g, double eta, uint64_t batches, core_mc_ring *rings) {
  const core_medium medium = {ratio / (1 + ratio), 1 / (1 + ratio) / (1 - g), g, eta};
  core_mc_request request = {.thickness_mm = (double)INFINITY, .albedo_count = 1, .seed = 20120101};
  core_mc_request_medium(&request, &medium);
  request.edges = (core_grid){CORE_SPACING_LOGARITHMIC, RINGS + 1, R_LEAST, R_MOST};
  if (core_mc_check(&request).field != NULL) {
    fail("a medium was refused");
  }
  core_mc_plan *plan = core_mc_plan_create(&request);
  core_mc_batch *batch = plan != NULL ? core_mc_batch_create(plan) : NULL;
  core_mc_total *total = plan != NULL ? core_mc_total_create(plan) : NULL;
  if (batch == NULL || total == NULL) {
    fail("out of memory");
  }
  for (uint64_t index = 0; index < batches; index++) {
    core_mc_batch_start(batch, index);
    while (!core_mc_batch_walk(batch, core_isa_select(NULL), UINT64_C(1) << 40)) {
    }
    core_mc_total_merge(total, batch);
  }
  core_mc_total_rings(total, 0, CORE_MC_REFLECTED, rings);
  core_mc_total_free(total);
  core_mc_batch_free(batch);
  core_mc_plan_free(plan);
}

/* Of the isotropic medium's rings from the anisotropic one's, where both are known to 5 %; NAN:
 * nowhere. */
static double ring_deviation(const core_mc_ring *isotropic, const core_mc_ring *truth) {
  double worst = (double)NAN;
  for (int i = 0; i < RINGS; i++) {
    const double error = hypot(isotropic[i].error_per_mm2 / isotropic[i].R_per_mm2,
                               truth[i].error_per_mm2 / truth[i].R_per_mm2);
    const double off = fabs(isotropic[i].R_per_mm2 / truth[i].R_per_mm2 - 1);
    if (error < 0.05) {
      worst = fmax(worst, fmax(off - 2 * error, 0)); /* fmax() passes over NAN */
    }
  }
  return worst;
}

/* Scattering forward takes 1 / (1 - g) times as long, and has the same range. */
static uint64_t batches_for(double g) {
  return (uint64_t)fmax(60, 300 * (1 - g));
}

static void print_anisotropic(void) {
  static const double gs[] = {-0.5, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98};
  static const double ratios[G_RATIOS] = {1e-4, 1e-2, 0.1, 1, 10};
  static const double etas[G_ETAS] = {1, 1.4, 2};
  static core_mc_ring isotropic[G_RATIOS][G_ETAS][RINGS];
  for (int i = 0; i < G_RATIOS; i++) {
    for (int e = 0; e < G_ETAS; e++) {
      walk(ratios[i], 0, etas[e], 600, isotropic[i][e]);
    }
  }
  for (size_t k = 0; k < sizeof gs / sizeof gs[0]; k++) {
    printf("ANISOTROPIC(%g", gs[k]);
    for (int i = 0; i < G_RATIOS; i++) {
      double worst = (double)NAN;
      for (int e = 0; e < G_ETAS; e++) {
        core_mc_ring rings[RINGS];
        walk(ratios[i], gs[k], etas[e], batches_for(gs[k]), rings);
        worst = fmax(worst, ring_deviation(isotropic[i][e], rings));
      }
      printf(", ");
      print_error(worst);
    }
    printf(")\n");
    fprintf(stderr, "model-errors: g = %g done\n", gs[k]);
  }
}

int main(int argc, char **argv) {
  if (argc != 2) {
    fail("usage: model-errors TRANSPORT.CSV > core/model_errors.def");
  }
  read_rows(argv[1]);
  printf(
      "/* Measured by core/tools/model_errors.c; core/model_error.h says what the numbers mean.\n"
      " *\n"
      " * ISOTROPIC(model, {errors at eta 1, 1.3, 1.5, 2} for each ratio from 1e-4 to 10)\n"
      " * ANISOTROPIC(g, error at ratio 1e-4, 0.01, 0.1, 1, 10)\n"
      " */\n");
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    print_isotropic(model);
  }
  print_anisotropic();
  return EXIT_SUCCESS;
}
