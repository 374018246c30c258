#include "tests/accuracy/walks.h"

#include <math.h>

#include "core/tools/tools.h"
#include "core/transport/gauss.h"

#define SLICE 1000000

static core_grid edges_of(size_t rings) {
  return (core_grid){CORE_SPACING_LOGARITHMIC, rings + 1, 0.0089125093813374545,
                     22.387211385683397};
}

/* A reduced mean free path is 1 mm. */
static core_mc_request request_of(const walks_medium *of, size_t rings, uint64_t seed) {
  const core_medium medium = {of->ratio / (1 + of->ratio), 1 / ((1 + of->ratio) * (1 - of->g)),
                              of->g, of->eta};
  core_mc_request request = {.thickness_mm = (double)INFINITY,
                             .edges = edges_of(rings),
                             .seed = seed,
                             .phase = of->phase,
                             .phase_share = of->phase_share,
                             .phase_g = of->phase_g};
  core_mc_request_medium(&request, &medium, 1);
  return request;
}

void walks_run(walks_result *result, const walks_medium *medium, size_t rings, uint64_t photons,
               uint64_t seed) {
  const core_mc_request request = request_of(medium, rings, seed);
  tools_check(core_mc_check(&request), "Monte Carlo");
  core_mc_plan *plan = core_mc_plan_create(&request);
  core_mc_total *total = plan != NULL ? core_mc_total_create(plan) : NULL;
  core_mc_batch *batch = plan != NULL ? core_mc_batch_create(plan) : NULL;
  if (total == NULL || batch == NULL) {
    tools_fail("out of memory");
  }
  const core_isa *isa = core_isa_select(NULL);
  for (uint64_t index = 0; index < photons / CORE_MC_BATCH_PHOTONS; index++) {
    core_mc_batch_start(batch, index);
    while (!core_mc_batch_walk(batch, isa, SLICE)) {
    }
    core_mc_total_merge(total, batch);
  }
  core_mc_energy energy;
  core_mc_total_energy(total, 0, &energy);
  result->total = energy.left[CORE_MC_REFLECTED];
  result->count = rings;
  core_mc_total_rings(total, 0, CORE_MC_REFLECTED, result->rings);
  core_mc_batch_free(batch);
  core_mc_total_free(total);
  core_mc_plan_free(plan);
}

/* By quadrature in r^2. */
double walks_mean(const solver_solution *solution, size_t eta, size_t rings, size_t ring,
                  double *error) {
  enum { NODES = 4 };
  const core_grid grid = edges_of(rings);
  double edge[2], sum = 0, errors = 0;
  gauss_rule rule;
  core_grid_radii_f64(&grid, ring, 2, edge);
  transport_gauss(&rule, NODES);
  const double from = edge[0] * edge[0], to = edge[1] * edge[1];
  for (size_t i = 0; i < rule.n; i++) {
    const double r = sqrt(from + (to - from) * rule.x[i]);
    const transport_number R = solver_at(solution, eta, r);
    sum += rule.weight[i] * R.value;
    errors += rule.weight[i] * R.error;
  }
  if (error != NULL) {
    *error = errors;
  }
  return sum;
}

/* The moments of 3 cos^2 / (4 pi) are 1, 0, 2/5, 0, ... Those that are left out are below 1e-12. */
void walks_phase(const walks_medium *medium, double *moment, solver_phase *phase) {
  const core_mc_request request = request_of(medium, 1, 0);
  const bool modified = medium->phase == CORE_PHASE_MODIFIED;
  const double share = medium->phase_share, first = core_mc_first_g(&request);
  double one = 1, other = 1;
  *phase = (solver_phase){medium->g, 0, moment};
  if (!modified && medium->phase != CORE_PHASE_TWO_TERM) {
    return;
  }
  while (phase->moments < SOLVER_MOMENTS_MAX &&
         (phase->moments < 3 || fabs(one) + fabs(other) > 1e-12)) {
    const size_t l = phase->moments++;
    const double second = !modified ? other : l == 0 ? 1 : l == 2 ? 0.4 : 0;
    moment[l] = l == 0 ? 1 : share * one + (1 - share) * second;
    one *= first;
    other *= modified ? 0 : medium->phase_g;
  }
}
