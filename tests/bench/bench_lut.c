/* Compares tables of one medium (the red channel of skin1, the default tolerance) with direct
 * evaluation in single precision: R at 4096 radii, by the best instruction set, in turn and in the
 * same run.
 *
 *   lut.<model>.table, lut.<model>.f32    values/s
 *   lut.<model>.prepare                   s, to build the table
 *   lut.<model>.prepare_f64               s, to prepare the model itself in double precision
 *   ratio.lut.transport_over_better_dipole   the table of transport over the better dipole itself,
 *                                            both for tissue with g = 0.9
 *   lut.transport_with_g.prepare          s, to build that table
 *   lut.transport_solved.prepare          s, to solve for g = 0.96
 *   lut.transport-g.prepare               us, a profile by the table of solutions and R at 16 radii,
 *                                         each of a medium with g and eta of its own
 */
#include <stdio.h>
#include <stdlib.h>

#include "core/core.h"
#include "tests/bench/bench.h"

enum { RADII = 4096, PREPARATIONS = 5, CONTENDERS = 2 };

/* Aligned to cache lines, or the ratios would depend on where the linker puts the arrays: a kernel
 * with vectors of 64 bytes is 5 % slower when each vector lies in two cache lines. */
static _Alignas(BENCH_ALIGNMENT) float radii[RADII];
static _Alignas(BENCH_ALIGNMENT) float values[RADII];

static void run_R(const void *context) {
  core_eval_f32(context, CORE_QUANTITY_R, RADII, radii, values);
}

static core_profile profile_with_g(unsigned model, unsigned evaluator, double g) {
  const core_medium tissue = {0.05, 0.95 / (1 - g), g, 1.4};
  core_profile profile;
  bench_fail_if(core_profile_prepare(&profile, core_isa_select(NULL), model, CORE_MOMENTS_EXACT,
                                     evaluator, &tissue, NULL)
                        .field != NULL,
                "tissue was refused");
  return profile;
}

static core_profile tissue_profile(unsigned model, unsigned evaluator) {
  return profile_with_g(model, evaluator, 0.9);
}

static core_profile solved_profile(unsigned model, unsigned evaluator) {
  return profile_with_g(model, evaluator, 0.96);
}

static core_profile measured_profile(unsigned model, unsigned evaluator) {
  return bench_profile(core_isa_select(NULL), model, evaluator);
}

static double median_s_to_prepare(unsigned model, unsigned evaluator,
                                  core_profile (*prepare)(unsigned, unsigned)) {
  double seconds[PREPARATIONS];
  for (int i = 0; i < PREPARATIONS; i++) {
    const uint64_t start = bench_now_ns();
    core_profile profile = prepare(model, evaluator);
    seconds[i] = (double)(bench_now_ns() - start) * 1e-9;
    core_profile_free(&profile);
  }
  return bench_median(seconds, PREPARATIONS);
}

/* Compares the table of one model with the direct evaluation of another. Returns how many times
 * faster the table is. */
static double compare(const char *what, const core_profile *table, const core_profile *direct,
                      bench_contender contenders[CONTENDERS]) {
  char progress[128];
  snprintf(progress, sizeof progress, "lut: %s", what);
  bench_progress(progress);
  contenders[0] = (bench_contender){.run = run_R, .context = table};
  contenders[1] = (bench_contender){.run = run_R, .context = direct};
  bench_compare(contenders, CONTENDERS);
  return contenders[1].ns / contenders[0].ns;
}

static void measure_model(const core_choice *model) {
  bench_contender contenders[CONTENDERS];
  core_profile table = bench_profile(core_isa_select(NULL), model->id, CORE_EVALUATOR_LUT);
  core_profile direct = bench_profile(core_isa_select(NULL), model->id, CORE_EVALUATOR_F32);
  compare(model->name, &table, &direct, contenders);
  bench_figure(RADII / contenders[0].ns * 1e9, "values/s", "lut.%s.table", model->name);
  bench_figure(RADII / contenders[1].ns * 1e9, "values/s", "lut.%s.f32", model->name);
  bench_figure(median_s_to_prepare(model->id, CORE_EVALUATOR_F64, measured_profile), "s",
               "lut.%s.prepare_f64", model->name);
  bench_figure(median_s_to_prepare(model->id, CORE_EVALUATOR_LUT, measured_profile), "s",
               "lut.%s.prepare", model->name);
  core_profile_free(&table);
  core_profile_free(&direct);
}

static void measure_transport(void) {
  bench_contender contenders[CONTENDERS];
  core_profile table = tissue_profile(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_LUT);
  core_profile direct = tissue_profile(CORE_MODEL_BETTER, CORE_EVALUATOR_F32);
  const double ratio = compare("transport over better", &table, &direct, contenders);
  bench_figure(ratio, "times", "ratio.lut.transport_over_better_dipole");
  bench_figure(median_s_to_prepare(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_LUT, tissue_profile), "s",
               "lut.transport_with_g.prepare");
  bench_figure(median_s_to_prepare(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64, solved_profile), "s",
               "lut.transport_solved.prepare");
  core_profile_free(&table);
  core_profile_free(&direct);
}

static void measure_solutions(void) {
  enum { MEDIA = 400, FEW = 16 };
  double us[PREPARATIONS], R[FEW];
  bench_progress("lut: profiles by the table of solutions");
  for (int i = 0; i < PREPARATIONS; i++) {
    const uint64_t start = bench_now_ns();
    for (int k = 0; k < MEDIA; k++) {
      const double g = 0.6 + 8e-4 * k;
      const core_medium medium = {0.05 + 1e-3 * k, 1 / (1 - g), g, 1.3 + 1e-3 * k};
      double r[FEW];
      core_profile profile;
      bench_fail_if(core_profile_prepare(&profile, core_isa_select(NULL), CORE_MODEL_TRANSPORT,
                                         CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, &medium, NULL)
                            .field != NULL,
                    "a medium was refused");
      for (int j = 0; j < FEW; j++) {
        r[j] = 0.1 * (j + 1);
      }
      core_eval_f64(&profile, CORE_QUANTITY_R, FEW, r, R);
      core_profile_free(&profile);
    }
    us[i] = (double)(bench_now_ns() - start) * 1e-3 / MEDIA;
  }
  bench_figure(bench_median(us, PREPARATIONS), "us", "lut.transport-g.prepare");
}

void bench_lut(void) {
  bench_fill_radii(sizeof *radii, radii, RADII);
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    measure_model(model);
  }
  measure_transport();
  measure_solutions();
}
