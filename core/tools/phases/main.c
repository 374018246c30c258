/* phases FOLDER FILE: measures how far R of the model `transport` with the parameter gamma is from
 * R of phase functions with that gamma, and writes core/gamma_errors.def. The truth is the
 * solver's, with each phase function's own moments. It keeps results in FOLDER, so that an
 * interrupted run continues where it stopped. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/kernels.h"
#include "core/model_error.h"
#include "core/tools/phases/mie.h"
#include "core/tools/reference/walks.h"
#include "core/tools/tools.h"

/* ---- the phase functions --------------------------------------------------------------------- */

enum kind { MODIFIED, TWO_TERM, MIE };

/* Of a mixture: the mean cosines of its Henyey-Greenstein functions and the share of the first. Of
 * spheres: refractive index, size and spread, as in mie.h. */
static const struct subject {
  enum kind kind;
  double a, b, c;
} subjects[] = {
    {MODIFIED, 0.9, 0.8, 0},  {MODIFIED, 0.9, 0.889, 0},    {MODIFIED, 0.9, 0.95, 0},
    {MODIFIED, 0.9, 0.98, 0}, {MODIFIED, 0.9, 0.99, 0},     {TWO_TERM, 0.9, 0.8, 0},
    {MIE, 1.1, 0.2, 1},       {TWO_TERM, 0.92, 0.99, -0.5}, {MIE, 1.33, 0.2, 0.8},
    {MIE, 1.1, 1, 0},
};

#define TOLERANCE 1e-3 /* of the solver */

static const double ratios[] = {1e-4, 0.1};
static const double etas[] = {0.8, 1, 1.4, 2};
static const double gammas[] = {0.8, 1.15, 1.35, 1.55, 1.75, 1.95}; /* edges of the ranges */

enum {
  SUBJECTS = sizeof subjects / sizeof subjects[0],
  RATIOS = sizeof ratios / sizeof ratios[0],
  ETAS = sizeof etas / sizeof etas[0],
  RANGES = sizeof gammas / sizeof gammas[0] - 1,
  ITEMS = SUBJECTS * RATIOS,
  BANDS = CORE_MODEL_ERROR_BANDS,
  IN_BAND = 4, /* radii in each band: both ends and two more */
  RADII = BANDS * IN_BAND,
  KEY_BYTES = 256
};

/* Sets *phase to a subject's phase function. `moment` has SOLVER_MOMENTS_MAX numbers. */
static void take_subject(const struct subject *subject, double *moment, solver_phase *phase) {
  if (subject->kind == MIE) {
    *phase = (solver_phase){
        0, mie_moments(subject->a, subject->b, subject->c, moment, SOLVER_MOMENTS_MAX), moment};
    return;
  }
  const bool modified = subject->kind == MODIFIED;
  const walks_medium medium = {.ratio = 1,
                               .g = subject->b * subject->a +
                                    (1 - subject->b) * (modified ? 0 : subject->c),
                               .eta = 1,
                               .phase = modified ? CORE_PHASE_MODIFIED : CORE_PHASE_TWO_TERM,
                               .phase_share = subject->b,
                               .phase_g = subject->c};
  walks_phase(&medium, moment, phase);
}

/* ---- the truth ------------------------------------------------------------------------------ */

/* What the solver has found for a phase function and a ratio. */
struct truth {
  double gamma, total[ETAS], R[ETAS][RADII];
};

struct item {
  struct truth truth;
  double error[BANDS + 1]; /* largest relative error in each band, and of the albedo */
};

struct run {
  const char *folder;
  struct item item[ITEMS];
  tools_progress progress;
};

/* Returns radius i, of band i / IN_BAND. A reduced mean free path is 1 mm. */
static double radius_of(size_t i) {
  const double from = core_error_edges_mfp[i / IN_BAND], to = core_error_edges_mfp[i / IN_BAND + 1];
  return from * pow(to / from, (double)(i % IN_BAND) / (IN_BAND - 1));
}

static void solve(struct truth *to, const struct subject *subject, double ratio) {
  static _Thread_local double moment[SOLVER_MOMENTS_MAX];
  const core_isa *isa = core_isa_select(NULL);
  solver_phase phase;
  solver_solution *solution;
  solver_total totals[ETAS];
  take_subject(subject, moment, &phase);
  to->gamma = (1 - moment[2]) / (1 - moment[1]);
  tools_check(solver_solve(&solution, isa, ratio, &phase, etas, ETAS, TOLERANCE), "the solver");
  tools_check(solver_totals(totals, isa, ratio, &phase, etas, ETAS), "the solver");
  for (size_t eta = 0; eta < ETAS; eta++) {
    to->total[eta] = totals[eta].normal.value;
    for (size_t i = 0; i < RADII; i++) {
      to->R[eta][i] = solver_at(solution, eta, radius_of(i)).value;
    }
  }
  solver_free(solution);
}

/* ---- the model ------------------------------------------------------------------------------- */

static void compare(struct item *item, double ratio, size_t eta) {
  const double gamma = item->truth.gamma;
  const core_medium medium = {ratio / (1 + ratio), 1 / ((1 + ratio) * (2 - gamma)), gamma - 1,
                              etas[eta]};
  if (!core_transport_is_stored(&medium)) {
    tools_fail("transport does not know gamma %g, ratio %g, eta %g", gamma, ratio, etas[eta]);
  }
  core_profile profile;
  tools_check(core_profile_prepare(&profile, core_isa_select(NULL), CORE_MODEL_TRANSPORT,
                                   CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, &medium, NULL),
              "transport");
  for (size_t i = 0; i < RADII; i++) {
    const double r = radius_of(i);
    double R;
    core_eval_f64(&profile, CORE_QUANTITY_R, 1, &r, &R);
    double *error = &item->error[i / IN_BAND];
    *error = fmax(*error, fabs(R / item->truth.R[eta][i] - 1));
  }
  double *error = &item->error[BANDS];
  *error = fmax(*error, fabs(profile.albedo / item->truth.total[eta] - 1));
  core_profile_free(&profile);
}

static void find(void *context, size_t i) {
  struct run *run = context;
  struct item *item = &run->item[i];
  const struct subject *subject = &subjects[i / RATIOS];
  const double ratio = ratios[i % RATIOS];
  char key[KEY_BYTES];
  snprintf(key, sizeof key, "%d %g %g %g, ratio %g", (int)subject->kind, subject->a, subject->b,
           subject->c, ratio);
  if (!tools_kept(run->folder, key, &item->truth, sizeof item->truth)) {
    solve(&item->truth, subject, ratio);
    tools_keep(run->folder, key, &item->truth, sizeof item->truth);
  }
  for (size_t eta = 0; eta < ETAS; eta++) {
    compare(item, ratio, eta);
  }
  tools_progress_add(&run->progress, 1);
}

/* ---- the list -------------------------------------------------------------------------------- */

/* Writes the largest errors of all phase functions with a gamma in a range. */
static void write_range(FILE *file, const struct run *run, size_t range) {
  fprintf(file, "CORE_GAMMA_ERROR(%g", gammas[range + 1]);
  for (size_t ratio = 0; ratio < RATIOS; ratio++) {
    fputs(",\n{", file);
    for (size_t band = 0; band <= BANDS; band++) {
      double error = 0;
      for (size_t i = ratio; i < ITEMS; i += RATIOS) {
        const struct item *item = &run->item[i];
        const bool inside =
            item->truth.gamma >= gammas[range] && item->truth.gamma <= gammas[range + 1];
        error = inside ? fmax(error, item->error[band]) : error;
      }
      if (error == 0) {
        tools_fail("no phase function has a gamma from %g to %g", gammas[range], gammas[range + 1]);
      }
      const double unit = pow(10, floor(log10(error)) - 2); /* rounded up to three digits */
      fprintf(file, "%s%.3g", band > 0 ? ", " : "", ceil(error / unit * (1 - 1e-12)) * unit);
    }
    fputs("}", file);
  }
  fputs(")\n", file);
}

static void write_list(FILE *file, const struct run *run) {
  fputs(
      "/* Errors of `transport` with the parameter gamma, which `make gamma-errors` has measured\n"
      " * (core/tools/phases/). core/model_error.h finds those of a medium.\n"
      " *\n"
      " * CORE_GAMMA_LEAST(gamma), CORE_GAMMA_RATIO(sigma_a / sigma_s') rising,\n"
      " * CORE_GAMMA_ETA(least, most)   where they were measured\n"
      " * CORE_GAMMA_ERROR(gamma, {...} for each ratio)   up to this gamma, from the one "
      "before:\n"
      " *   the largest error among modified and two-term Henyey-Greenstein functions and those "
      "of\n"
      " *   spheres, relative, for each band of radii and for the albedo\n"
      " */\n/* clang-format off */\n",
      file);
  static const char *const names[] = {"LEAST(gamma)", "RATIO(ratio)", "ETA(least, most)",
                                      "ERROR(gamma, ...)"};
  for (size_t i = 0; i < 4; i++) {
    const int length = (int)strcspn(names[i], "(");
    fprintf(file, "#ifndef CORE_GAMMA_%.*s\n#define CORE_GAMMA_%s\n#endif\n", length, names[i],
            names[i]);
  }
  fprintf(file, "\nCORE_GAMMA_LEAST(%g)\n", gammas[0]);
  for (size_t i = 0; i < RATIOS; i++) {
    fprintf(file, "CORE_GAMMA_RATIO(%g)\n", ratios[i]);
  }
  fprintf(file, "CORE_GAMMA_ETA(%g, %g)\n", etas[0], etas[ETAS - 1]);
  for (size_t i = 0; i < RANGES; i++) {
    write_range(file, run, i);
  }
  fputs("\n", file);
  for (size_t i = 0; i < 4; i++) {
    fprintf(file, "#undef CORE_GAMMA_%.*s\n", (int)strcspn(names[i], "("), names[i]);
  }
}

int main(int argc, char **argv) {
  if (argc != 3) {
    tools_fail("usage: phases FOLDER FILE");
  }
  static struct run run;
  run.folder = argv[1];
  tools_make_folder(argv[1]);
  tools_progress_start(&run.progress, ITEMS);
  tools_each(tools_processors(), ITEMS, find, &run);
  tools_progress_end(&run.progress);
  FILE *file = tools_open(argv[2]);
  write_list(file, &run);
  tools_close(file, argv[2]);
  for (size_t i = 0; i < ITEMS; i++) {
    printf("gamma %.3f, ratio %g:", run.item[i].truth.gamma, ratios[i % RATIOS]);
    for (size_t band = 0; band <= BANDS; band++) {
      printf(" %.3f", run.item[i].error[band]);
    }
    puts("");
  }
  return EXIT_SUCCESS;
}
