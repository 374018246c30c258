/* Measures Monte Carlo in photons per second on one core: by every instruction set of this machine,
 * and by a plain scalar walk that treats weights as MCML does, in turn. MCML itself is not run. Its
 * speed (version 1.2.2, one core of a 2-core Xeon) is known for the three half spaces measured.
 *
 *   mc.<medium>.<instruction set or plain>   photons/s
 *   ratio.mc.<medium>.plain                  the best instruction set over the plain walk
 *   ratio.mc.<medium>.mcml                   the best instruction set over MCML's known speed
 *   mc.<medium>.worth.total, .worth.r5       what a photon is worth, since the figures above count
 *                                            photons only: the variance of the total R, or of the
 *                                            ring at 5 mm, for as many photons that are kept down
 *                                            to MCML's weight of 1e-4, over that of our photons
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/montecarlo/montecarlo.h"
#include "tests/bench/bench.h"
#include "tests/bench/plain_walk.h"

static const struct {
  const char *name;
  double sigma_a;
  double sigma_s;
  double g;
  double eta;
  double mcml_per_s;
} media[] = {
    {"a0.9_n1.5", 0.1, 0.9, 0, 1.5, 0.40e6},
    {"mua0.1_mus10_n1.4", 0.01, 1, 0, 1.4, 103e3},
    {"mua0.1_mus50_g0.8_n1.4", 0.01, 5, 0.8, 1.4, 22e3},
};
enum { MEDIA = sizeof media / sizeof media[0], RINGS = 100, CONTENDERS_MAX = 8 };

static core_mc_request make_request(size_t i) {
  core_mc_request request = {
      .thickness_mm = (double)INFINITY,
      .edges = {CORE_SPACING_LINEAR, RINGS + 1, 0, 10},
      .seed = 1995,
  };
  const core_medium medium = {media[i].sigma_a, media[i].sigma_s, media[i].g, media[i].eta};
  core_mc_request_medium(&request, &medium);
  return request;
}

/* ---- speed -------------------------------------------------------------------------------- */

/* The argument of a run. A unit of work is one batch, which has the same size for the plain
 * walk. */
struct work {
  const char *name;
  const core_isa *isa; /* NULL: the plain walk */
  core_mc_batch *batch;
  plain_medium plain;
};

static void run_batch(const void *context) {
  const struct work *work = context;
  core_mc_batch_start(work->batch, 0);
  while (!core_mc_batch_walk(work->batch, work->isa, UINT64_MAX)) {
  }
}

static void run_plain(const void *context) {
  static double rings[RINGS];
  const struct work *work = context;
  uint64_t random = 1995;
  for (int i = 0; i < CORE_MC_BATCH_PHOTONS; i++) {
    const plain_photon p = plain_walk(&work->plain, &random);
    const double r = 10 * sqrt(p.x * p.x + p.y * p.y);
    rings[p.fate == PLAIN_REFLECTED && r < RINGS ? (int)r : RINGS - 1] += p.weight;
  }
}

static void measure_speed(size_t medium, const core_mc_plan *plan) {
  const core_mc_request *request = core_mc_plan_request(plan);
  struct work work[CONTENDERS_MAX];
  bench_contender contenders[CONTENDERS_MAX];
  size_t count = 0;
  core_mc_batch *batch = core_mc_batch_create(plan);
  if (batch == NULL) {
    bench_fail("out of memory");
  }
  for (size_t i = 0; core_isa_listed(i) != NULL && count < CONTENDERS_MAX - 1; i++) {
    const core_isa *isa = core_isa_select(core_isa_listed(i));
    if (isa != NULL) {
      work[count] = (struct work){.name = core_isa_name(isa), .isa = isa, .batch = batch};
      contenders[count] = (bench_contender){.run = run_batch, .context = &work[count]};
      count++;
    }
  }
  const plain_medium plain = {request->albedo[0], request->g, request->eta, (double)INFINITY};
  work[count] = (struct work){.name = "plain", .plain = plain};
  contenders[count] = (bench_contender){.run = run_plain, .context = &work[count]};
  bench_compare(contenders, count + 1);

  double best_ns = (double)INFINITY;
  for (size_t i = 0; i <= count; i++) {
    bench_figure(CORE_MC_BATCH_PHOTONS / contenders[i].ns * 1e9, "photons/s", "mc.%s.%s",
                 media[medium].name, work[i].name);
    best_ns = i < count ? fmin(best_ns, contenders[i].ns) : best_ns;
  }
  bench_figure(contenders[count].ns / best_ns, "times", "ratio.mc.%s.plain", media[medium].name);
  bench_figure(CORE_MC_BATCH_PHOTONS / best_ns * 1e9 / media[medium].mcml_per_s, "times",
               "ratio.mc.%s.mcml", media[medium].name);
  core_mc_batch_free(batch);
}

/* ---- what a photon is worth --------------------------------------------------------------- */

enum { WORTH_BATCHES = 100, FAR_RING = 50 };

struct variances {
  double total;
  double far_ring;
};

static struct variances measure_variances(const core_mc_plan *plan) {
  core_mc_batch *batch = core_mc_batch_create(plan);
  core_mc_total *total = core_mc_total_create(plan);
  if (batch == NULL || total == NULL) {
    bench_fail("out of memory");
  }
  const core_isa *isa = core_isa_select(NULL);
  for (uint64_t index = 0; index < WORTH_BATCHES; index++) {
    core_mc_batch_start(batch, index);
    while (!core_mc_batch_walk(batch, isa, UINT64_MAX)) {
    }
    core_mc_total_merge(total, batch);
  }
  core_mc_energy energy;
  core_mc_ring rings[RINGS];
  core_mc_total_energy(total, 0, &energy);
  core_mc_total_rings(total, 0, CORE_MC_REFLECTED, rings);
  core_mc_batch_free(batch);
  core_mc_total_free(total);
  const double error = energy.left[CORE_MC_REFLECTED].error;
  const double ring_error = rings[FAR_RING].error_per_mm2;
  return (struct variances){error * error, ring_error * ring_error};
}

static core_mc_plan *make_plan(const core_mc_request *request) {
  core_mc_plan *plan = core_mc_check(request).field == NULL ? core_mc_plan_create(request) : NULL;
  if (plan == NULL) {
    bench_fail("a medium was refused, or out of memory");
  }
  return plan;
}

static void measure(size_t medium) {
  char what[64];
  snprintf(what, sizeof what, "mc: %s", media[medium].name);
  bench_progress(what);
  core_mc_request request = make_request(medium);
  core_mc_plan *plan = make_plan(&request);
  measure_speed(medium, plan);

  request.roulette_weight = PLAIN_ROULETTE_WEIGHT;
  core_mc_plan *light = make_plan(&request);
  const struct variances usual = measure_variances(plan);
  const struct variances kept = measure_variances(light);
  bench_figure(kept.total / usual.total, "times", "mc.%s.worth.total", media[medium].name);
  bench_figure(kept.far_ring / usual.far_ring, "times", "mc.%s.worth.r5", media[medium].name);
  core_mc_plan_free(light);
  core_mc_plan_free(plan);
}

void bench_mc(void) {
  for (size_t i = 0; i < MEDIA; i++) {
    measure(i);
  }
}
