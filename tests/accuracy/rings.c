/* rings MILLIONS
 * rings media SEED COUNT [FIRST]
 * rings walked MILLIONS [MEDIUM]
 * rings stacks SEED COUNT [FIRST]
 *
 * The first form compares Monte Carlo with the solver for any phase function, ring by ring, with at
 * least MILLIONS of photons for each g and for each mixture of two functions. It exits with
 * EXIT_FAILURE if any ring or total is off by 4.5 standard errors or more, or if chi-squared per
 * ring is not between 0.8 and 1.2 for a g, or for all. `make rings` walks 100 millions each, `make
 * check-rings` 4.
 *
 * The standard errors are Monte Carlo's alone, as if the solver had no error: whatever error it has
 * raises chi-squared. The error that the solver states is a bound, not a standard error. What it
 * could add to chi-squared if all of it were there, the mean of its square in standard errors, is
 * printed beside it.
 *
 * `media` solves COUNT media, from number FIRST of a seed on, that the table of solutions does not
 * cover, with the tolerance 1e-3 and on a grid two levels finer (at most the finest), and prints a
 * line of CSV for each: found is the largest relative difference of R from 0.01 to 30 mean free
 * paths, and share the largest difference over what is stated at its radius, which is `at`.
 *
 * `walked` walks at least MILLIONS of photons for each of ten such media, or for MEDIUM (0 to 9) of
 * them, and prints a line of CSV for each ring, with what the solver (tolerance 1e-3) has and
 * states; beyond is by how many standard errors Monte Carlo is off by more than what is stated.
 *
 * `stacks` solves COUNT random stacks of 1 to 5 layers with the tolerances 1e-2 and 1e-3 and on the
 * finest grid, and prints a line of CSV for R and one for T of each: the largest relative error that
 * is stated from 0.05 to 30 reduced mean free paths of the first layer, where R is above 1e-9 of its
 * largest, and share, the largest difference from that grid over what is stated. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "core/kernels.h"
#include "core/splitmix.h"
#include "core/tools/tools.h"
#include "core/transport/table.h"
#include "tests/accuracy/walks.h"

#define SIGMAS_MOST 4.5
/* The standard errors of rings with few photons are known too badly. */
#define PHOTONS_LEAST 1000

static const struct subject {
  const char *name;
  double g;
  unsigned phase;
  double share, second;
} subjects[] = {
    {"g -0.3", -0.3, 0, 0, 0},
    {"g 0.3", 0.3, 0, 0, 0},
    {"g 0.7", 0.7, 0, 0, 0},
    {"g 0.8", 0.8, 0, 0, 0},
    {"g 0.9", 0.9, 0, 0, 0},
    {"g 0.95", 0.95, 0, 0, 0},
    {"g 0.8, modified 0.889", 0.8, CORE_PHASE_MODIFIED, 0.889, 0},
    {"g 0.9, two-term 0.95 and -0.3", 0.9, CORE_PHASE_TWO_TERM, 0.95, -0.3},
};
static const struct { double ratio, eta; } media[] = {{0.2, 1.4}, {1, 1}};

enum {
  SUBJECTS = sizeof subjects / sizeof subjects[0],
  MEDIA = sizeof media / sizeof media[0],
  RUNS = SUBJECTS * MEDIA,
  RINGS = 170,
  SEED = 20120101
};

/* With more photons, a smaller tolerance is asked for: the solver's error has to be small beside the
 * standard error of a ring, or chi-squared says nothing. */
#define FINEST_FROM_MILLIONS 20

struct run {
  double tolerance;
  uint64_t photons; /* of each medium */
  tools_progress progress;
  struct found {
    double chi_squared, worst, total; /* of rings; of the total, in standard errors */
    double bound_squared;             /* the solver's bounds in standard errors, squared, added */
    size_t rings;
  } found[RUNS];
};

static void compare(struct found *to, const walks_result *walked, const solver_solution *solution,
                    transport_number total) {
  for (size_t i = 0; i < walked->count; i++) {
    const core_mc_ring *ring = &walked->rings[i];
    double error;
    const double R = walks_mean(solution, 0, walked->count, i, &error);
    if (ring->photons >= PHOTONS_LEAST) {
      const double off = fabs(ring->R_per_mm2 - R) / ring->error_per_mm2;
      const double bound = error / ring->error_per_mm2;
      to->chi_squared += off * off;
      to->bound_squared += bound * bound;
      to->worst = fmax(to->worst, off);
      to->rings++;
    }
  }
  to->total = fabs(walked->total.value - total.value) / walked->total.error;
}

static void run_one(void *context, size_t i) {
  struct run *run = context;
  const struct subject *subject = &subjects[i / MEDIA];
  const walks_medium medium = {media[i % MEDIA].ratio, subject->g,     media[i % MEDIA].eta,
                               subject->phase,         subject->share, subject->second};
  static _Thread_local double moment[SOLVER_MOMENTS_MAX];
  solver_solution *solution;
  solver_phase phase;
  solver_total totals;
  walks_result walked;
  walks_phase(&medium, moment, &phase);
  tools_check(solver_solve(&solution, core_isa_select(NULL), medium.ratio, &phase, &medium.eta, 1,
                           run->tolerance),
              "the solver");
  tools_check(solver_totals(&totals, core_isa_select(NULL), medium.ratio, &phase, &medium.eta, 1),
              "the solver");
  walks_run(&walked, &medium, RINGS, run->photons, SEED + i);
  compare(&run->found[i], &walked, solution, totals.normal);
  solver_free(solution);
  tools_progress_add(&run->progress, 1);
}

static void add(struct found *to, const struct found *from) {
  to->chi_squared += from->chi_squared;
  to->bound_squared += from->bound_squared;
  to->rings += from->rings;
  to->worst = fmax(to->worst, fmax(from->worst, from->total));
}

static bool judge(const char *name, const struct found *sum) {
  const double per_ring = sum->chi_squared / (double)sum->rings;
  const bool good = per_ring > 0.8 && per_ring < 1.2 && sum->worst < SIGMAS_MOST;
  printf("rings: %-30s %4zu rings, chi-squared per ring %.3f (the solver's bound: %.3f), at most "
         "%.2f standard errors%s\n",
         name, sum->rings, per_ring, sum->bound_squared / (double)sum->rings, sum->worst,
         good ? "" : ": BEYOND THE BOUNDS");
  return good;
}

/* ---- media that the table does not cover ------------------------------------------------------ */

#define TOLERANCE 1e-3
enum { FINER = 2 }; /* levels */

static double between(uint64_t *state, double low, double high) {
  return low + (high - low) * core_splitmix_f64(state);
}

/* A tenth of the media absorb nothing. */
static walks_medium draw_medium(uint64_t *state) {
  for (;;) {
    const bool white = core_splitmix_f64(state) < 0.1;
    const double ratio = exp(between(state, log(1e-5), log(1000)));
    const double far = between(state, 0.85, 0.99), any = between(state, -0.95, 0.99);
    const double g = core_splitmix_f64(state) < 0.4 ? far : any;
    const walks_medium drawn = {
        .ratio = white ? 0 : ratio, .g = g, .eta = exp(between(state, log(0.3), log(3.9)))};
    const core_medium medium = {drawn.ratio, 1 / (1 - drawn.g), drawn.g, drawn.eta};
    if (!core_transport_is_stored(&medium)) {
      return drawn;
    }
  }
}

static double seconds_now(void) {
  struct timespec now;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static bool check_medium(const walks_medium *medium) {
  const core_isa *isa = core_isa_select(NULL);
  const solver_phase phase = {.g = medium->g};
  solver_solution *solution, *finer;
  const double start = seconds_now();
  tools_check(solver_solve(&solution, isa, medium->ratio, &phase, &medium->eta, 1, TOLERANCE),
              "the solver");
  const double solved = seconds_now();
  const size_t level = solver_level(solution);
  const size_t fine = level + FINER < SOLVER_LEVELS ? level + FINER : SOLVER_LEVELS - 1;
  tools_check(
      solver_solve_level(&finer, isa, medium->ratio, &phase, &medium->eta, 1, fine, NULL, false),
      "the solver");
  double stated = 0, found = 0, share = 0, at = 0;
  for (double r = 0.01; r < 30; r *= 1.25) {
    const double truth = solver_at(finer, 0, r).value;
    const transport_number R = solver_at(solution, 0, r);
    if (truth < TRANSPORT_TABLE_R_LEAST) {
      break;
    }
    const double off = fabs(R.value - truth);
    stated = fmax(stated, R.error / truth);
    found = fmax(found, off / truth);
    if (!(off <= share * R.error)) {
      share = off / R.error;
      at = r;
    }
  }
  printf("%.9g,%.9g,%.9g,%zu,%zu,%.3g,%.3g,%.3g,%.3g,%.3g,%.3g\n", medium->ratio, medium->g,
         medium->eta, level, fine, stated, found, share, at, solved - start,
         seconds_now() - solved);
  fflush(stdout);
  solver_free(solution);
  solver_free(finer);
  return share <= 1;
}

static bool check_media(uint64_t seed, size_t count, size_t first) {
  uint64_t state = seed;
  bool good = true;
  printf("ratio,g,eta,level,finer,stated,found,share,at,seconds,finer_seconds\n");
  for (size_t i = 0; i < first + count; i++) {
    const walks_medium medium = draw_medium(&state);
    good = (i < first || check_medium(&medium)) && good;
  }
  return good;
}

/* ---- such media, walked ------------------------------------------------------------------------- */

enum { WALKED = 10, PARTS = 16 }; /* each medium is walked in so many parts */

static const walks_medium walked_media[WALKED] = {
    {.ratio = 0.1, .g = 0.99, .eta = 1.4},  {.ratio = 0.03, .g = 0.97, .eta = 1.4},
    {.ratio = 20, .g = 0.98, .eta = 2},     {.ratio = 0.5, .g = 0.96, .eta = 3.5},
    {.ratio = 0.3, .g = 0.9, .eta = 3.9},   {.ratio = 3, .g = 0.8, .eta = 0.4},
    {.ratio = 0.001, .g = 0.5, .eta = 2.5}, {.ratio = 0.1, .g = 0, .eta = 0.3},
    {.ratio = 0.2, .g = -0.6, .eta = 1.33}, {.ratio = 0.05, .g = -0.95, .eta = 0.6},
};

struct walked {
  uint64_t photons;    /* of each part */
  size_t first, count; /* media */
  tools_progress progress;
  walks_result results[WALKED][PARTS];
  solver_solution *solutions[WALKED];
};

/* Solves the media, then walks their parts. */
static void walk_one(void *context, size_t i) {
  struct walked *run = context;
  const size_t number = run->first + i % run->count;
  const walks_medium *medium = &walked_media[number];
  if (i < run->count) {
    const solver_phase phase = {.g = medium->g};
    tools_check(solver_solve(&run->solutions[number], core_isa_select(NULL), medium->ratio, &phase,
                             &medium->eta, 1, TOLERANCE),
                "the solver");
  } else {
    const size_t part = i / run->count - 1;
    walks_run(&run->results[number][part], medium, WALKS_TENTHS, run->photons,
              SEED + WALKED * (part + 1) + number);
  }
  tools_progress_add(&run->progress, 1);
}

/* Prints the rings of a medium, and returns by how many standard errors one is beyond at most. */
static double print_walked(const struct walked *run, size_t i) {
  const walks_medium *medium = &walked_media[i];
  double worst = 0;
  for (size_t ring = 0; ring < WALKS_TENTHS; ring++) {
    double walked = 0, squares = 0, stated;
    uint64_t photons = 0;
    const core_mc_ring *edges = &run->results[i][0].rings[ring];
    for (size_t part = 0; part < PARTS; part++) {
      const core_mc_ring *of = &run->results[i][part].rings[ring];
      walked += of->R_per_mm2 / PARTS;
      squares += of->error_per_mm2 * of->error_per_mm2 / (PARTS * PARTS);
      photons += of->photons;
    }
    const double R = walks_mean(run->solutions[i], 0, WALKS_TENTHS, ring, &stated);
    const double error = sqrt(squares), beyond = (fabs(walked - R) - stated) / error;
    worst = photons >= PHOTONS_LEAST ? fmax(worst, beyond) : worst;
    printf("%g,%g,%g,%.6g,%.6g,%.7g,%.2g,%.7g,%.2g,%llu,%.2f\n", medium->ratio, medium->g,
           medium->eta, edges->from_mm, edges->to_mm, walked, error, R, stated,
           (unsigned long long)photons, beyond);
  }
  return worst;
}

static bool check_walked(double millions, size_t first, size_t count) {
  static struct walked run;
  run.first = first;
  run.count = count;
  run.photons =
      ((uint64_t)(millions * 1e6 / PARTS) / CORE_MC_BATCH_PHOTONS + 1) * CORE_MC_BATCH_PHOTONS;
  tools_progress_start(&run.progress, count * (1 + PARTS));
  tools_each(tools_processors(), count * (1 + PARTS), walk_one, &run);
  tools_progress_end(&run.progress);
  printf("ratio,g,eta,from,to,walked,sigma,solved,stated,photons,beyond\n");
  double worst = 0;
  for (size_t i = first; i < first + count; i++) {
    worst = fmax(worst, print_walked(&run, i));
    solver_free(run.solutions[i]);
  }
  return worst < SIGMAS_MOST;
}

/* ---- stacks of layers ------------------------------------------------------------------------- */

enum { STACK_LAYERS = 5, FINEST_LEVEL = 4 };

static size_t draw_stack(uint64_t *state, solver_layer layer[STACK_LAYERS], double *eta_below) {
  const size_t count = 1 + (size_t)(core_splitmix(state) % STACK_LAYERS);
  const bool steps = core_splitmix_f64(state) < 0.5, deep = core_splitmix_f64(state) < 0.5;
  const double eta = between(state, 1, 1.6), sigma_t = exp(between(state, log(0.3), log(30)));
  for (size_t i = 0; i < count; i++) {
    const double extinction = sigma_t * exp(between(state, log(0.32), log(3.1)));
    const double white = core_splitmix_f64(state), part = exp(between(state, log(1e-4), log(0.9)));
    const double absorbed = white < 0.1 ? 0 : part, g = between(state, -0.5, 0.99);
    const double own = between(state, 1, 1.6), mfps = exp(between(state, log(1e-3), log(100)));
    const double reduced = extinction * (absorbed + (1 - absorbed) * (1 - g));
    layer[i] =
        (solver_layer){extinction * absorbed, extinction * (1 - absorbed), g, steps ? own : eta,
                       i + 1 == count && deep ? INFINITY : mfps / reduced};
  }
  *eta_below = between(state, 1, 1.6);
  return count;
}

static bool check_stack(size_t number, const solver_layer *layer, size_t count, double eta_below) {
  const core_isa *isa = core_isa_select(NULL);
  static const double tolerances[] = {1e-2, 1e-3};
  enum { TOLERANCES = sizeof tolerances / sizeof tolerances[0] };
  solver_layers *fine, *solution[TOLERANCES];
  double seconds[TOLERANCES];
  for (size_t i = 0; i < TOLERANCES; i++) {
    const double start = seconds_now();
    const core_fault fault =
        solver_layers_solve(&solution[i], isa, layer, count, eta_below, tolerances[i], NULL);
    seconds[i] = seconds_now() - start;
    if (fault.field != NULL) {
      printf("%zu,%zu,refused: %s %s\n", number, count, fault.field, fault.allowed);
      return true;
    }
  }
  tools_check(solver_layers_solve_level(&fine, isa, layer, count, eta_below, FINEST_LEVEL, NULL),
              "the solver");
  const double mfp_mm = 1 / (layer[0].sigma_a_per_mm + layer[0].sigma_s_per_mm * (1 - layer[0].g));
  bool good = true;
  for (size_t side = 0; side < (isinf(layer[count - 1].thickness_mm) ? 1 : SOLVER_SIDES); side++) {
    printf("%zu,%zu,%c", number, count, "RT"[side]);
    for (size_t i = 0; i < TOLERANCES; i++) {
      double stated = 0, share = 0, at = 0;
      const double large = solver_layers_at(fine, side, 0.05 * mfp_mm).value;
      for (double r = 0.05; r < 30; r *= 1.25) {
        const double truth = solver_layers_at(fine, side, r * mfp_mm).value;
        const transport_number R = solver_layers_at(solution[i], side, r * mfp_mm);
        if (!(truth > 1e-9 * large)) {
          break;
        }
        stated = fmax(stated, R.error / truth);
        if (!(fabs(R.value - truth) <= share * R.error)) {
          share = fabs(R.value - truth) / R.error;
          at = r;
        }
      }
      printf(",%.3g,%.3g,%.3g,%.3g", stated, share, at, seconds[i]);
      good = good && share <= 1;
    }
    printf("\n");
  }
  fflush(stdout);
  for (size_t i = 0; i < TOLERANCES; i++) {
    solver_layers_free(solution[i]);
  }
  solver_layers_free(fine);
  return good;
}

static bool check_stacks(uint64_t seed, size_t count, size_t first) {
  uint64_t state = seed;
  bool good = true;
  printf("stack,layers,of,stated_2,share_2,at_2,seconds_2,stated_3,share_3,at_3,seconds_3\n");
  for (size_t i = 0; i < first + count; i++) {
    solver_layer layer[STACK_LAYERS];
    double eta_below;
    const size_t layers = draw_stack(&state, layer, &eta_below);
    good = (i < first || check_stack(i, layer, layers, eta_below)) && good;
  }
  return good;
}

static double number_of(const char *text) {
  return text != NULL ? atof(text) : 0;
}

int main(int argc, char **argv) {
  if (argc >= 4 && (strcmp(argv[1], "media") == 0 || strcmp(argv[1], "stacks") == 0)) {
    const uint64_t seed = (uint64_t)number_of(argv[2]);
    const size_t count = (size_t)number_of(argv[3]), first = (size_t)number_of(argv[4]);
    return (argv[1][0] == 'm' ? check_media : check_stacks)(seed, count, first) ? EXIT_SUCCESS
                                                                                : EXIT_FAILURE;
  }
  const bool walks = argc >= 3 && strcmp(argv[1], "walked") == 0;
  const double millions = argc == 2 || walks ? atof(argv[walks ? 2 : 1]) : 0;
  const double one = walks ? number_of(argv[3]) : 0;
  if (!(millions >= 0.1 && millions <= 1e6 && one >= 0 && one < WALKED)) {
    tools_fail("usage: rings MILLIONS | media SEED COUNT [FIRST] | walked MILLIONS [MEDIUM] | "
               "stacks SEED COUNT [FIRST]");
  }
  if (walks) {
    const bool all = argv[3] == NULL;
    return check_walked(millions, (size_t)one, all ? WALKED : 1) ? EXIT_SUCCESS : EXIT_FAILURE;
  }
  static struct run run;
  run.tolerance = millions < FINEST_FROM_MILLIONS ? 1e-3 : 1e-4;
  run.photons =
      ((uint64_t)(millions * 1e6 / MEDIA) / CORE_MC_BATCH_PHOTONS + 1) * CORE_MC_BATCH_PHOTONS;
  tools_progress_start(&run.progress, RUNS);
  tools_each(tools_processors(), RUNS, run_one, &run);
  tools_progress_end(&run.progress);
  bool good = true;
  struct found all = {0};
  for (size_t i = 0; i < SUBJECTS; i++) {
    struct found sum = {0};
    for (size_t j = i * MEDIA; j < (i + 1) * MEDIA; j++) {
      add(&sum, &run.found[j]);
    }
    good = judge(subjects[i].name, &sum) && good;
    add(&all, &sum);
  }
  good = judge("all", &all) && good;
  printf("(%.0f million photons for each)\n", (double)run.photons * MEDIA / 1e6);
  return good ? EXIT_SUCCESS : EXIT_FAILURE;
}
