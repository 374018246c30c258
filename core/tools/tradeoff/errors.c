#include "core/tools/tradeoff/errors.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/tools/tools.h"
#include "core/transport/transport.h"

/* The estimated work for one node, for the progress bar only. */
static const double cost_us[] = {[ERRORS_NODES] = 110000, [ERRORS_ROWS] = 200000};

errors_node *errors_at_node(const errors_table *table, size_t eta, size_t ratio, size_t model) {
  return &table->nodes[(eta * NODES_RATIOS + ratio) * table->of->model_count + model];
}

errors_row *errors_at_row(const errors_table *table, size_t eta, size_t ratio, size_t s) {
  return &table->rows[(eta * NODES_PAPER_RATIOS + ratio) * table->of->count + s];
}

double errors_cost_us(enum errors_what what) {
  return cost_us[what] *
         (what == ERRORS_NODES ? NODES_ETAS * NODES_RATIOS : NODES_PAPER_ETAS * NODES_PAPER_RATIOS);
}

/* ---- one node -------------------------------------------------------------------------------- */

struct truth {
  double r[NODES_RADII];
  double R[NODES_RADII];
  double albedo;
};

static void solve(struct truth *truth, transport_boundary *boundary, const core_medium *medium) {
  transport_solution *solution;
  tools_check(transport_solve(&solution, boundary, medium->sigma_s_per_mm), "transport");
  nodes_radii(truth->r);
  for (size_t i = 0; i < NODES_RADII; i++) {
    truth->R[i] = transport_at(solution, truth->r[i]).R.value;
  }
  truth->albedo = transport_total(solution).value;
  transport_solution_free(solution);
}

/* Writes |R / R_transport - 1| at each radius. */
static void deviations(const core_profile *profile, const struct truth *truth,
                       double off[NODES_RADII]) {
  subjects_evaluate(profile, NODES_RADII, truth->r, off);
  for (size_t i = 0; i < NODES_RADII; i++) {
    off[i] = fabs(off[i] / truth->R[i] - 1);
    if (isnan(off[i])) {
      tools_fail("a model's R is not a number at %g mean free paths", truth->r[i]);
    }
  }
}

static void fill_node(errors_node *node, const core_profile *profile, const struct truth *truth) {
  double off[NODES_RADII];
  deviations(profile, truth, off);
  for (size_t band = 0; band < NODES_BANDS; band++) {
    node->worst[band] = 0;
    for (size_t i = nodes_band_start(band); i <= nodes_band_start(band + 1); i++) {
      node->worst[band] = fmax(node->worst[band], off[i]);
    }
  }
  node->albedo = fabs(profile->albedo / truth->albedo - 1);
}

static void refuse_node(errors_node *node) {
  for (size_t band = 0; band < NODES_BANDS; band++) {
    node->worst[band] = (double)INFINITY;
  }
  node->albedo = (double)INFINITY;
}

static void fill_row(errors_row *row, const core_profile *profile, const struct truth *truth) {
  double off[NODES_RADII];
  deviations(profile, truth, off);
  row->worst = row->worst_far = 0;
  for (size_t i = 0; i < NODES_RADII; i++) {
    row->worst = fmax(row->worst, off[i]);
    row->worst_far = truth->r[i] >= ERRORS_FAR ? fmax(row->worst_far, off[i]) : row->worst_far;
  }
  row->median = tools_median(off, NODES_RADII);
  row->albedo = fabs(profile->albedo / truth->albedo - 1);
  row->numerical =
      profile->numerical_error + profile->numerical_error_per_mm * truth->r[NODES_RADII - 1];
}

/* ---- all of them ----------------------------------------------------------------------------- */

/* The nodes of one eta. They share transport's solution for the boundary. */
struct eta_nodes {
  const errors_table *table;
  size_t eta;
  enum errors_what what;
  transport_boundary *boundary;
  tools_progress *progress;
};

static void measure_models(const struct eta_nodes *all, size_t ratio, const core_medium *medium,
                           const struct truth *truth) {
  const subjects *of = all->table->of;
  for (size_t s = 0; s < of->count; s++) {
    const subject *one = &of->all[s];
    const core_choice *model = of->models[one->model].model;
    core_profile profile;
    /* The other models are measured against `transport`, which is left out. */
    if (one->evaluator->id == CORE_EVALUATOR_F64 && model->id != CORE_MODEL_TRANSPORT) {
      errors_node *node = errors_at_node(all->table, all->eta, ratio, one->model);
      if (subjects_prepare(&profile, of, one, medium, (double)NAN).field != NULL) {
        refuse_node(node);
        continue;
      }
      fill_node(node, &profile, truth);
      core_profile_free(&profile);
    }
  }
}

/* Returns the position of a ratio in the paper's list: the number of the paper's ratios before it.
 */
static size_t paper_position(size_t ratio) {
  size_t position = 0;
  for (size_t i = 0; i < ratio; i++) {
    position += nodes_ratio_is_papers(i);
  }
  return position;
}

static void measure_subjects(const struct eta_nodes *all, size_t ratio, const core_medium *medium,
                             const struct truth *truth) {
  const subjects *of = all->table->of;
  for (size_t s = 0; s < of->count; s++) {
    core_profile profile;
    errors_row *row = errors_at_row(all->table, all->eta / 2, paper_position(ratio), s);
    if (subjects_prepare(&profile, of, &of->all[s], medium, (double)NAN).field != NULL) {
      *row = (errors_row){(double)NAN, (double)NAN, (double)NAN, (double)NAN, (double)NAN};
      continue;
    }
    fill_row(row, &profile, truth);
    core_profile_free(&profile);
  }
}

static void measure(void *context, size_t ratio) {
  const struct eta_nodes *all = context;
  const core_medium medium = nodes_medium(ratio, all->eta);
  struct truth truth;
  if (all->what == ERRORS_ROWS && !nodes_ratio_is_papers(ratio)) {
    return;
  }
  solve(&truth, all->boundary, &medium);
  if (all->what == ERRORS_NODES) {
    measure_models(all, ratio, &medium, &truth);
  } else {
    measure_subjects(all, ratio, &medium, &truth);
  }
  tools_progress_add(all->progress, cost_us[all->what]);
}

/* Allocates memory that is all 0. */
static void *allocate(size_t count, size_t bytes) {
  void *room = calloc(count, bytes);
  if (room == NULL) {
    tools_fail("out of memory");
  }
  return room;
}

void errors_measure(errors_table *table, const subjects *of, enum errors_what what, size_t threads,
                    tools_progress *progress) {
  const size_t nodes = (size_t)NODES_ETAS * NODES_RATIOS * of->model_count;
  const size_t rows = (size_t)NODES_PAPER_ETAS * NODES_PAPER_RATIOS * of->count;
  *table = (errors_table){.of = of};
  if (what == ERRORS_NODES) {
    table->nodes = allocate(nodes, sizeof *table->nodes);
  } else {
    table->rows = allocate(rows, sizeof *table->rows);
  }
  for (size_t eta = 0; eta < NODES_ETAS; eta++) {
    char stage[64];
    struct eta_nodes all = {.table = table, .eta = eta, .what = what, .progress = progress};
    if (what == ERRORS_ROWS && !nodes_eta_is_papers(eta)) {
      continue;
    }
    snprintf(stage, sizeof stage, "errors, eta %g", nodes_eta(eta));
    tools_progress_stage(progress, stage);
    tools_check(transport_boundary_create(&all.boundary, nodes_eta(eta), ERRORS_LEAST),
                "transport");
    tools_each(threads, NODES_RATIOS, measure, &all);
    transport_boundary_free(all.boundary);
  }
}

void errors_free(errors_table *table) {
  free(table->nodes);
  free(table->rows);
}
