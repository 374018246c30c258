/* Measures what it takes to solve layers of skin, by the best instruction set, in one thread:
 *
 *   solver.<tolerance>.<layers>         s of a processor to solve
 *   solver.<tolerance>.<layers>.error   largest relative error that is stated from 0.05 to 20
 *                                       reduced mean free paths of the first layer
 *   ratio.solver.<tolerance>.walks      over the solver's time, that in which walks of two layers
 *                                       have this standard error in each of 20 rings from 0.05 to
 *                                       5 reduced mean free paths, from what some seconds have
 */
#include <math.h>
#include <time.h>

#include "core/montecarlo/montecarlo.h"
#include "core/solver/solver.h"
#include "tests/bench/bench.h"

enum { LAYERS = 4, RINGS = 20 };

/* Epidermis, dermis, subcutaneous fat and muscle near 633 nm. The last one of a stack is a half
 * space. One layer is dermis. */
static const solver_layer skin[LAYERS] = {{1.5, 20, 0.8, 1.4, 0.06},
                                          {0.03, 15, 0.8, 1.4, 2},
                                          {0.01, 10, 0.8, 1.4, 3},
                                          {0.05, 8, 0.9, 1.4, INFINITY}};

static double processor_s(void) {
  return (double)clock() / CLOCKS_PER_SEC;
}

static double radius_of(const solver_layer *layer) {
  return 1 / (layer->sigma_a_per_mm + layer->sigma_s_per_mm * (1 - layer->g));
}

/* Returns the time in s. */
static double measure_solution(size_t count, double tolerance) {
  solver_layer layer[LAYERS];
  solver_layers *solution;
  for (size_t i = 0; i < count; i++) {
    layer[i] = skin[count == 1 ? 1 : i];
  }
  layer[count - 1].thickness_mm = INFINITY;
  const double start_s = processor_s();
  bench_fail_if(solver_layers_solve(&solution, core_isa_select(NULL), layer, count,
                                    layer[count - 1].eta, tolerance, NULL)
                        .field != NULL,
                "layers were refused");
  const double taken_s = processor_s() - start_s;
  double most = 0;
  for (double r = SOLVER_RADIUS_MOST; r >= 0.05; r /= 1.2) {
    const transport_number R = solver_layers_at(solution, 0, r * radius_of(layer));
    most = fmax(most, R.error / R.value);
  }
  solver_layers_free(solution);
  bench_figure(taken_s, "s", "solver.%g.%zu", tolerance, count);
  bench_figure(most, "relative", "solver.%g.%zu.error", tolerance, count);
  return taken_s;
}

/* Returns the time in s after which the standard error in each ring would be 1, relative. */
static double measure_walks(double seconds) {
  core_medium layer[2];
  for (size_t i = 0; i < 2; i++) {
    layer[i] = (core_medium){.sigma_a_per_mm = skin[i].sigma_a_per_mm,
                             .sigma_s_per_mm = skin[i].sigma_s_per_mm,
                             .g = skin[i].g,
                             .eta = skin[i].eta,
                             .thickness_mm = i == 0 ? skin[i].thickness_mm : 0};
  }
  core_mc_request request = {
      .seed = 1,
      .edges = {CORE_SPACING_LOGARITHMIC, RINGS + 1, 0.05 * radius_of(skin), 5 * radius_of(skin)}};
  core_mc_request_medium(&request, layer, 2);
  core_mc_plan *plan = core_mc_plan_create(&request);
  core_mc_batch *batch = plan != NULL ? core_mc_batch_create(plan) : NULL;
  core_mc_total *total = plan != NULL ? core_mc_total_create(plan) : NULL;
  bench_fail_if(batch == NULL || total == NULL, "out of memory");
  const double start_s = processor_s();
  for (uint64_t i = 0; processor_s() - start_s < seconds; i++) {
    core_mc_batch_start(batch, i);
    while (!core_mc_batch_walk(batch, core_isa_select(NULL), UINT64_MAX)) {
    }
    core_mc_total_merge(total, batch);
  }
  const double taken_s = processor_s() - start_s;
  core_mc_ring ring[RINGS];
  core_mc_total_rings(total, 0, CORE_MC_REFLECTED, ring);
  double most = 0;
  for (size_t i = 0; i < RINGS; i++) {
    most = fmax(most, ring[i].error_per_mm2 / ring[i].R_per_mm2);
  }
  core_mc_total_free(total);
  core_mc_batch_free(batch);
  core_mc_plan_free(plan);
  return taken_s * most * most;
}

void bench_solver(void) {
  static const double tolerance[] = {1e-2, 1e-3};
  bench_progress("solver");
  const double walks_s = measure_walks(bench_is_long ? 30 : 5);
  for (size_t i = 0; i < sizeof tolerance / sizeof *tolerance; i++) {
    for (size_t count = 1; count <= LAYERS; count++) {
      const double taken_s = measure_solution(count, tolerance[i]);
      if (count == 2) {
        bench_figure(walks_s / (tolerance[i] * tolerance[i]) / taken_s, "times",
                     "ratio.solver.%g.walks", tolerance[i]);
      }
    }
  }
}
