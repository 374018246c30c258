/* Compares Monte Carlo on one core with a plain scalar walk that treats weights as MCML does, and with
 * the known speed of MCML 1.2.2 itself on one core of a 2-core Xeon.
 *
 *   mc.<medium>.dipole, .plain                           photons a second                     1/s
 *   ratio.mc.<medium>.plain, .mcml                       dipole over these
 */
#include <math.h>

#include "core/montecarlo/montecarlo.h"
#include "tests/accuracy/plain_walk.h"
#include "tests/bench/bench.h"

static const struct {
  const char *name;
  core_medium medium;
  double mcml_per_s;
} media[] = {
    {"a0.9_n1.5", {0.1, 0.9, 0, 1.5, 0}, 0.40e6},
    {"mua0.1_mus10_n1.4", {0.01, 1, 0, 1.4, 0}, 103e3},
    {"mua0.1_mus50_g0.8_n1.4", {0.01, 5, 0.8, 1.4, 0}, 22e3},
};
enum { RINGS = 100, PLAIN_PHOTONS = 64 };

static void run_batch(const void *context) {
  core_mc_batch *batch = *(core_mc_batch *const *)context;
  core_mc_batch_start(batch, 0);
  while (!core_mc_batch_walk(batch, core_isa_select(NULL), UINT64_MAX)) {
  }
}

static void run_plain(const void *context) {
  static double rings[RINGS];
  uint64_t random = 1995;
  for (int i = 0; i < PLAIN_PHOTONS; i++) {
    const plain_photon p = plain_walk(context, &random);
    const double r = 10 * hypot(p.x, p.y);
    rings[p.fate == PLAIN_REFLECTED && r < RINGS ? (int)r : RINGS - 1] += p.weight;
  }
}

void bench_mc(void) {
  for (size_t i = 0; i < sizeof media / sizeof media[0]; i++) {
    const core_medium *medium = &media[i].medium;
    const double extinction = medium->sigma_a_per_mm + medium->sigma_s_per_mm;
    const plain_medium plain = {medium->sigma_s_per_mm / extinction, medium->g, medium->eta,
                                (double)INFINITY};
    core_mc_request request = {.thickness_mm = (double)INFINITY,
                               .edges = {CORE_SPACING_LINEAR, RINGS + 1, 0, 10},
                               .seed = 1995};
    core_mc_request_medium(&request, medium, 1);
    core_mc_plan *plan = core_mc_plan_create(&request);
    core_mc_batch *batch = plan != NULL ? core_mc_batch_create(plan) : NULL;
    bench_fail_if(batch == NULL, "out of memory");
    bench_contender sides[] = {{run_batch, &batch, 0}, {run_plain, &plain, 0}};
    bench_compare(sides, 2);
    const double per_s = CORE_MC_BATCH_PHOTONS / sides[0].ns * 1e9;
    const double plain_per_s = PLAIN_PHOTONS / sides[1].ns * 1e9;
    bench_figure(per_s, "1/s", "mc.%s.dipole", media[i].name);
    bench_figure(plain_per_s, "1/s", "mc.%s.plain", media[i].name);
    bench_figure(per_s / plain_per_s, "times", "ratio.mc.%s.plain", media[i].name);
    bench_figure(per_s / media[i].mcml_per_s, "times", "ratio.mc.%s.mcml", media[i].name);
    core_mc_batch_free(batch);
    core_mc_plan_free(plan);
  }
}
