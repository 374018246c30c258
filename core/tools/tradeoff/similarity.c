#include "core/tools/tradeoff/similarity.h"

#include <math.h>

#include "core/montecarlo/montecarlo.h"
#include "core/tools/tools.h"
#include "core/transport/transport.h"

enum { ETAS = 3, RINGS = 48, WALKS = SIMILARITY_GS * ETAS };

#define SEED 20120101
#define TRANSPORT_TOLERANCE 1e-6
#define PHOTON_COST_US 3.0 /* time of a photon at g = 0 */

/* The bands below this one, with radii below 0.1 mean free paths, are not measured by Monte Carlo.
 */
#define FIRST_BAND 3

const double similarity_gs[SIMILARITY_GS] = {0.95, 0.98};
const double similarity_ratios[SIMILARITY_RATIOS] = {1e-4, 1e-3, 0.01, 0.03, 0.1, 0.2,
                                                     0.5,  1,    2,    5,    10};
static const double etas[ETAS] = {1, 1.4, 2};

/* Returns the number of batches for a g. A photon takes 1 / (1 - g) times as long, so fewer photons
 * are walked for g near 1. */
static uint64_t batches_for(double g) {
  return (uint64_t)fmax(150, 400 * (1 - g));
}

static double walk_cost_us(double g) {
  return (double)(batches_for(g) * CORE_MC_BATCH_PHOTONS) * PHOTON_COST_US / (1 - g);
}

double similarity_cost_us(void) {
  double us = 0;
  for (size_t i = 0; i < SIMILARITY_GS; i++) {
    us += ETAS * walk_cost_us(similarity_gs[i]);
  }
  return us;
}

/* Returns sigma_t / sigma_t' of a medium. */
static double scale_of(double g, double ratio) {
  return (ratio + 1 / (1 - g)) / (ratio + 1);
}

/* Runs one walk for all ratios at once, with lengths in mean free paths 1 / sigma_t. */
static core_mc_total *walk(double g, double eta, core_mc_plan **plan) {
  core_mc_request request = {.sigma_t_per_mm = 1,
                             .g = g,
                             .eta = eta,
                             .thickness_mm = (double)INFINITY,
                             .albedo_count = SIMILARITY_RATIOS,
                             .seed = SEED};
  double least = (double)INFINITY, most = 0;
  for (size_t i = 0; i < SIMILARITY_RATIOS; i++) {
    const double scale = scale_of(g, similarity_ratios[i]);
    request.albedo[i] = 1 / (1 + similarity_ratios[i] * (1 - g));
    least = fmin(least, nodes_edges[FIRST_BAND] * scale);
    most = fmax(most, nodes_edges[NODES_BANDS] * scale);
  }
  request.edges = (core_grid){CORE_SPACING_LOGARITHMIC, RINGS + 1, least, most};
  tools_check(core_mc_check(&request), "Monte Carlo");
  *plan = core_mc_plan_create(&request);
  core_mc_batch *batch = *plan != NULL ? core_mc_batch_create(*plan) : NULL;
  core_mc_total *total = *plan != NULL ? core_mc_total_create(*plan) : NULL;
  if (batch == NULL || total == NULL) {
    tools_fail("out of memory");
  }
  for (uint64_t index = 0; index < batches_for(g); index++) {
    core_mc_batch_start(batch, index);
    while (!core_mc_batch_walk(batch, core_isa_select(NULL), UINT64_MAX)) {
    }
    core_mc_total_merge(total, batch);
  }
  core_mc_batch_free(batch);
  return total;
}

/* Returns the relative deviation of a value with isotropic scattering from Monte Carlo's value,
 * plus two standard errors of the latter. INFINITY if that value is too uncertain. */
static double deviation(double value, core_mc_value truth) {
  return truth.error < SIMILARITY_KNOWN * truth.value
             ? fabs(value / truth.value - 1) + 2 * truth.error / truth.value
             : (double)INFINITY;
}

/* Returns the mean of R over a ring by Simpson's rule for r^2 R over ln r. Lengths are in mean free
 * paths 1 / sigma_t'. */
static double ring_mean(const transport_solution *solution, double from, double to) {
  const double r[] = {from, sqrt(from * to), to}, weight[] = {1, 4, 1};
  double sum = 0;
  for (size_t i = 0; i < 3; i++) {
    sum += weight[i] * r[i] * r[i] * transport_at(solution, r[i]).R.value;
  }
  return sum * log(to / from) / 3 / ((to - from) * (to + from));
}

static void compare(similarity_node *node, const core_mc_total *total, size_t albedo, double scale,
                    const transport_solution *solution) {
  core_mc_ring rings[RINGS];
  core_mc_energy energy;
  core_mc_total_rings(total, albedo, CORE_MC_REFLECTED, rings);
  core_mc_total_energy(total, albedo, &energy);
  node->albedo = deviation(transport_total(solution).value, energy.left[CORE_MC_REFLECTED]);
  for (size_t band = 0; band < NODES_BANDS; band++) {
    node->worst[band] = band < FIRST_BAND ? (double)INFINITY : 0;
    for (size_t i = 0; i < RINGS; i++) {
      const double from = rings[i].from_mm / scale, to = rings[i].to_mm / scale;
      if (from < nodes_edges[band + 1] && to > nodes_edges[band]) {
        const core_mc_value truth = {rings[i].R_per_mm2 * scale * scale,
                                     rings[i].error_per_mm2 * scale * scale};
        node->worst[band] =
            fmax(node->worst[band], deviation(ring_mean(solution, from, to), truth));
      }
    }
  }
}

struct campaign {
  similarity_node found[WALKS][SIMILARITY_RATIOS];
  tools_progress *progress;
};

static void measure(void *context, size_t i) {
  struct campaign *all = context;
  /* The largest g comes first, as it takes longest. */
  const size_t k = SIMILARITY_GS - 1 - i / ETAS;
  const double g = similarity_gs[k], eta = etas[i % ETAS];
  transport_boundary *boundary;
  core_mc_plan *plan;
  core_mc_total *total = walk(g, eta, &plan);
  tools_check(transport_boundary_create(&boundary, eta, TRANSPORT_TOLERANCE), "transport");
  for (size_t ratio = 0; ratio < SIMILARITY_RATIOS; ratio++) {
    transport_solution *solution;
    tools_check(transport_solve(&solution, boundary, 1 / (1 + similarity_ratios[ratio])),
                "transport");
    compare(&all->found[k * ETAS + i % ETAS][ratio], total, ratio,
            scale_of(g, similarity_ratios[ratio]), solution);
    transport_solution_free(solution);
  }
  transport_boundary_free(boundary);
  core_mc_total_free(total);
  core_mc_plan_free(plan);
  tools_progress_add(all->progress, walk_cost_us(g));
}

void similarity_measure(similarity_node nodes[SIMILARITY_GS][SIMILARITY_RATIOS], size_t threads,
                        tools_progress *progress) {
  static struct campaign all;
  all.progress = progress;
  tools_progress_stage(progress, "similarity relation");
  tools_each(threads, WALKS, measure, &all);
  for (size_t k = 0; k < SIMILARITY_GS; k++) {
    for (size_t ratio = 0; ratio < SIMILARITY_RATIOS; ratio++) {
      similarity_node *node = &nodes[k][ratio];
      *node = (similarity_node){0};
      for (size_t e = 0; e < ETAS; e++) {
        const similarity_node *one = &all.found[k * ETAS + e][ratio];
        for (size_t band = 0; band < NODES_BANDS; band++) {
          node->worst[band] = fmax(node->worst[band], one->worst[band]);
        }
        node->albedo = fmax(node->albedo, one->albedo);
      }
    }
  }
}
