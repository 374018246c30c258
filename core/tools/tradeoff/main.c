/* tradeoff DIR: measures the speed of every model of a half space that needs only a medium, with each
 * evaluator, on one core with this machine's best instruction set, and its error against transport at
 * the media of Figures 1 to 16 of d'Eon 2012, for three eta of their eleven: some minutes. It writes DIR/costs.def, which `make tradeoff` copies to
 * core/, and DIR/tradeoff.csv, which draw.py reads.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "core/ruler.h"
#include "core/tools/tools.h"

static const double etas[] = {1, 1.4, 2};
static const double ratios[] = {1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05,
                                0.1,  0.2,  0.5,  1,    2,    5,    10}; /* sigma_a / sigma_s' */

enum {
  RATIOS = sizeof ratios / sizeof ratios[0],
  ETAS = sizeof etas / sizeof etas[0],
  MEDIA = RATIOS * ETAS,
  RADII = 128, /* from 0.01 to 20 mean free paths, in equal ratios */
  SUBJECTS_MAX = 128,
  PATH_BYTES = 4096
};

/* Returns a medium with sigma_t' = 1 per mm, so that radii in mm are in mean free paths. */
static core_medium medium_of(double ratio, double g, double eta) {
  return (core_medium){ratio / (1 + ratio), 1 / (1 + ratio) / (1 - g), g, eta};
}

/* A model with an evaluator, and what was measured. */
struct subject {
  const core_choice *model, *evaluator;
  double evaluate_ns; /* for R at one radius */
  double prepare_ns;  /* for one medium */
  struct errors {     /* of R, relative; NAN if the medium is refused */
    double worst, median;
  } error[MEDIA];
};

static struct run {
  struct subject subject[SUBJECTS_MAX];
  size_t count;
  tools_progress progress;
} run;

static bool prepare(core_profile *profile, const struct subject *of, const core_medium *medium,
                    double tolerance) {
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_TOLERANCE] = tolerance;
  return core_profile_prepare(profile, core_isa_select(NULL), of->model->id, CORE_MOMENTS_EXACT,
                              of->evaluator->id, medium, &parameters)
             .field == NULL;
}

/* Returns why the comparison leaves a model out, or NULL if it does not. */
static const char *why_left_out(unsigned model) {
  const core_medium medium = {0.05, 1, 0, 1.4};
  core_profile profile;
  if (model == CORE_MODEL_GAUSSIANS) {
    return "a fit, as far off as the model that it is fitted to";
  }
  const core_fault fault =
      core_profile_prepare(&profile, core_isa_select(NULL), model, CORE_MOMENTS_EXACT,
                           CORE_EVALUATOR_F64, &medium, NULL);
  if (fault.field != NULL) {
    return fault.field; /* the parameter that the model needs */
  }
  const bool fixed = (profile.notes & CORE_NOTE_MEDIUM_UNUSED) != 0;
  core_profile_free(&profile);
  return fixed ? "the same profile for every medium" : NULL;
}

static void find_subjects(void) {
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    const char *why = why_left_out(model->id);
    if (why != NULL) {
      printf("left out: %s (%s)\n", model->name, why);
      continue;
    }
    for (const core_choice *evaluator = core_evaluators; evaluator->name != NULL; evaluator++) {
      if (run.count == SUBJECTS_MAX) {
        tools_fail("there are more evaluators than SUBJECTS_MAX allows");
      }
      run.subject[run.count++] = (struct subject){.model = model, .evaluator = evaluator};
    }
  }
}

/* ---- errors ---------------------------------------------------------------------------------- */

/* The tolerance of transport as the ruler; smaller errors cannot be measured. */
#define ERROR_LEAST 1e-7

static void compare(const struct subject *subject, const core_medium *medium,
                    const core_profile *ruler, const double *r, struct errors *to) {
  core_profile profile;
  double error[RADII];
  *to = (struct errors){(double)NAN, (double)NAN};
  if (!prepare(&profile, subject, medium, (double)NAN)) {
    return;
  }
  core_model_errors_at(&profile, ruler, CORE_QUANTITY_R, RADII, r, error);
  to->worst = 0;
  for (size_t i = 0; i < RADII; i++) {
    to->worst = fmax(to->worst, error[i]);
  }
  to->median = tools_median(error, RADII);
  core_profile_free(&profile);
}

static void compare_all(void *context, size_t m) {
  (void)context;
  const core_medium medium = medium_of(ratios[m / ETAS], 0, etas[m % ETAS]);
  const struct subject solved = {.model = core_choice_by_id(core_models, CORE_MODEL_TRANSPORT),
                                 .evaluator =
                                     core_choice_by_id(core_evaluators, CORE_EVALUATOR_F64)};
  core_profile ruler;
  double r[RADII];
  if (!prepare(&ruler, &solved, &medium, ERROR_LEAST)) {
    tools_fail("transport refuses ratio %g, eta %g", ratios[m / ETAS], medium.eta);
  }
  for (size_t i = 0; i < RADII; i++) { /* numbers of single precision, which no evaluator rounds */
    r[i] = (double)(float)(0.01 * pow(2000, (double)i / (RADII - 1)));
  }
  for (size_t s = 0; s < run.count; s++) {
    compare(&run.subject[s], &medium, &ruler, r, &run.subject[s].error[m]);
  }
  core_profile_free(&ruler);
  tools_progress_add(&run.progress, 1);
}

/* ---- costs ----------------------------------------------------------------------------------- */

enum { ROUNDS = 31, LENGTH = 4096, EVALUATION_MEDIA = 3, PREPARATION_MEDIA = 12, PREPARATIONS = 5 };

/* A sample takes at least this: far longer than reading the clock, far shorter than a time slice.
 */
#define TOLERANCE                                                                                  \
  1e-3 /* with which profiles are prepared that are timed, if they are not transport */
#define BEYOND_G 0.96 /* a g that the table of solutions does not cover */
#define SAMPLE_NS 100000.0
#define PREPARING_NS 20e6 /* preparing is repeated for about this time */

/* Returns the processor time of this thread, so that other programs do not count. */
static double now_ns(void) {
  struct timespec now;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return (double)now.tv_sec * 1e9 + (double)now.tv_nsec;
}

static struct {
  double f64[LENGTH], out_f64[LENGTH];
  float f32[LENGTH], out_f32[LENGTH];
} arrays;

/* Fills in radii with a uniform density in ln r from 0.01 to 20 mm. Their order is random, so that
 * branch predictors cannot learn it. */
static void fill_arrays(void) {
  uint32_t random = 1;
  for (size_t i = 0; i < LENGTH; i++) {
    random = random * 1664525u + 1013904223u;
    arrays.f32[i] = (float)(0.01 * pow(2000, (random >> 8) * 0x1p-24));
    arrays.f64[i] = (double)arrays.f32[i];
  }
}

static double evaluate_ns(const core_profile *profile, size_t runs) {
  const double start = now_ns();
  for (size_t i = 0; i < runs; i++) {
    if (profile->evaluator == CORE_EVALUATOR_F64) {
      core_eval_f64(profile, CORE_QUANTITY_R, LENGTH, arrays.f64, arrays.out_f64);
    } else {
      core_eval_f32(profile, CORE_QUANTITY_R, LENGTH, arrays.f32, arrays.out_f32);
    }
  }
  return now_ns() - start;
}

/* Returns the median of the values that are numbers, or NAN if there are none. */
static double median_of_numbers(const double *values, size_t n) {
  double numbers[PREPARATION_MEDIA];
  size_t count = 0;
  for (size_t i = 0; i < n; i++) {
    if (!isnan(values[i])) {
      numbers[count++] = values[i];
    }
  }
  return count > 0 ? tools_median(numbers, count) : (double)NAN;
}

/* Times evaluating. The subjects are timed in turns, round after round, so that other load on the
 * machine affects all of them equally. */
static void time_evaluating(void) {
  static const core_medium media[EVALUATION_MEDIA] = {
      {0.001, 1, 0, 1.4}, {0.05, 1, 0, 1.4}, {0.5, 0.5, 0, 1.4}};
  static core_profile profile[SUBJECTS_MAX];
  static double ns[SUBJECTS_MAX][EVALUATION_MEDIA];
  for (size_t m = 0; m < EVALUATION_MEDIA; m++) {
    static double samples[SUBJECTS_MAX][ROUNDS];
    size_t runs[SUBJECTS_MAX];
    for (size_t s = 0; s < run.count; s++) {
      runs[s] = prepare(&profile[s], &run.subject[s], &media[m], TOLERANCE);
      while (runs[s] > 0 && evaluate_ns(&profile[s], runs[s]) < SAMPLE_NS) {
        runs[s] *= 2;
      }
    }
    for (size_t round = 0; round < ROUNDS; round++) {
      for (size_t s = 0; s < run.count; s++) {
        if (runs[s] > 0) {
          evaluate_ns(&profile[s], 1); /* loads its tables into the nearest cache */
          samples[s][round] = evaluate_ns(&profile[s], runs[s]) / (double)(runs[s] * LENGTH);
        }
      }
    }
    for (size_t s = 0; s < run.count; s++) {
      ns[s][m] = runs[s] > 0 ? tools_median(samples[s], ROUNDS) : (double)NAN;
      if (runs[s] > 0) {
        core_profile_free(&profile[s]);
      }
    }
    tools_progress_add(&run.progress, 4);
  }
  for (size_t s = 0; s < run.count; s++) {
    run.subject[s].evaluate_ns = median_of_numbers(ns[s], EVALUATION_MEDIA);
  }
}

static double prepare_ns(const struct subject *of, const core_medium *medium, double tolerance) {
  double samples[PREPARATIONS];
  size_t count = 0;
  const double start = now_ns();
  do {
    core_profile profile;
    const double begin = now_ns();
    if (!prepare(&profile, of, medium, tolerance)) {
      return (double)NAN;
    }
    samples[count++] = now_ns() - begin;
    core_profile_free(&profile);
  } while (count < PREPARATIONS && now_ns() - start < PREPARING_NS);
  return tools_median(samples, count);
}

/* Returns the median over the twelve pairs of four ratios and three eta, with g other than 0, as
 * tissue has. */
static double time_preparing(const struct subject *of, double g, double tolerance) {
  static const double of_ratio[] = {1e-3, 1e-2, 0.1, 1}, of_eta[] = {1.1, 1.4, 1.8};
  double ns[PREPARATION_MEDIA];
  for (size_t i = 0; i < PREPARATION_MEDIA; i++) {
    const core_medium medium = medium_of(of_ratio[i % 4], g, of_eta[i / 4]);
    ns[i] = prepare_ns(of, &medium, tolerance);
  }
  return median_of_numbers(ns, PREPARATION_MEDIA);
}

/* ---- files ----------------------------------------------------------------------------------- */

static FILE *open_in(char path[PATH_BYTES], const char *folder, const char *name) {
  if (snprintf(path, PATH_BYTES, "%s/%s", folder, name) >= PATH_BYTES) {
    tools_fail("%s: the name is too long", folder);
  }
  return tools_open(path);
}

static void put_number(FILE *file, double number) {
  isnan(number) ? fputs(",", file) : fprintf(file, ",%.6g", number);
}

/* Writes a row for each subject and medium; fields are empty if a medium is refused. */
static void write_csv(const char *folder) {
  char path[PATH_BYTES];
  FILE *file = open_in(path, folder, "tradeoff.csv");
  fputs("model,evaluator,ratio,eta,cost_ns,prepare_ns,worst,median\n", file);
  for (size_t s = 0; s < run.count; s++) {
    const struct subject *of = &run.subject[s];
    for (size_t m = 0; m < MEDIA; m++) {
      fprintf(file, "%s,%s,%g,%.1f", of->model->name, of->evaluator->name, ratios[m / ETAS],
              etas[m % ETAS]);
      put_number(file, of->evaluate_ns);
      put_number(file, of->prepare_ns);
      put_number(file, of->error[m].worst);
      put_number(file, of->error[m].median);
      fputc('\n', file);
    }
  }
  tools_close(file, path);
}

static const char costs_head[] =
    "/* Costs that `make tradeoff` has measured (core/tools/tradeoff/). core/choose.h chooses by "
    "them.\n"
    " *\n"
    " * CORE_COST(model id, ns for a radius by f64, by f32, ns to prepare, ns to prepare a table "
    "(lut))\n"
    " * CORE_COST_LUT(ns for a radius by a table)\n"
    " * CORE_COST_SOLVE(ns to solve transport where its table of solutions does not serve)\n"
    " */\n"
    "/* clang-format off */\n"
    "#ifndef CORE_COST\n#define CORE_COST(model, f64, f32, prepare, prepare_lut)\n#endif\n"
    "#ifndef CORE_COST_LUT\n#define CORE_COST_LUT(lut)\n#endif\n"
    "#ifndef CORE_COST_SOLVE\n#define CORE_COST_SOLVE(solve)\n#endif\n\n";

/* Writes core/costs.def. The evaluators of a model follow each other: f64, f32, lut. */
static void write_costs(const char *folder, double solve_ns) {
  char path[PATH_BYTES];
  double lut_ns[SUBJECTS_MAX];
  const size_t models = run.count / 3;
  FILE *file = open_in(path, folder, "costs.def");
  for (size_t i = 0; i < models; i++) {
    lut_ns[i] = run.subject[3 * i + 2].evaluate_ns;
  }
  fputs(costs_head, file);
  fprintf(file, "CORE_COST_LUT(%.3g)\nCORE_COST_SOLVE(%.2g)\n", tools_median(lut_ns, models),
          solve_ns);
  for (size_t i = 0; i < models; i++) {
    const struct subject *of = &run.subject[3 * i];
    fprintf(file, "CORE_COST(%u, %.3g, %.3g, %.3g, %.3g) /* %s */\n", of->model->id,
            of[0].evaluate_ns, of[1].evaluate_ns, of[0].prepare_ns, of[2].prepare_ns,
            of->model->name);
  }
  fputs("\n#undef CORE_COST\n#undef CORE_COST_LUT\n#undef CORE_COST_SOLVE\n", file);
  tools_close(file, path);
}

int main(int argc, char **argv) {
  if (argc != 2) {
    tools_fail("usage: tradeoff DIR");
  }
  double solve_ns = (double)NAN;
  tools_make_folder(argv[1]);
  find_subjects();
  fill_arrays();
  tools_progress_start(&run.progress, 4 * EVALUATION_MEDIA + (double)run.count + MEDIA);
  tools_progress_stage(&run.progress, "cost of evaluating");
  time_evaluating();
  tools_progress_stage(&run.progress, "cost of preparing");
  for (size_t s = 0; s < run.count; s++) {
    struct subject *of = &run.subject[s];
    const bool transport = of->model->id == CORE_MODEL_TRANSPORT;
    of->prepare_ns = time_preparing(of, 0.9, transport ? (double)NAN : TOLERANCE);
    if (transport && of->evaluator->id == CORE_EVALUATOR_F64) {
      solve_ns = time_preparing(of, BEYOND_G, (double)NAN);
    }
    tools_progress_add(&run.progress, 1);
  }
  tools_progress_stage(&run.progress, "errors");
  tools_each(tools_processors(), MEDIA, compare_all, NULL);
  tools_progress_end(&run.progress);
  write_csv(argv[1]);
  write_costs(argv[1], solve_ns);
  return EXIT_SUCCESS;
}
