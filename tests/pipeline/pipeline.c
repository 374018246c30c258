/* pipeline REQUESTS ADDRESS: sends REQUESTS requests through libdipole. Eight threads each have a
 * connection and many outstanding queries, and collect the answers in random order: some by id,
 * some in the order of arrival, some into memory of their own. No two requests are alike. The
 * program compares every answer, bit for bit, with its own evaluation of the same radii, so that an
 * answer to another request is noticed. ADDRESS may name several daemons. It prints how many
 * requests were answered, and how fast. It exits with 1 at the first answer that is wrong, doubled
 * or missing. */
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "clients/c/dipole.h"
#include "core/core.h"
#include "core/splitmix.h"

enum {
  THREADS = 8,
  IN_FLIGHT = 256,
  RADII_MAX = 4,
  MODELS = 2,
  MEDIA = 2,
  EVALUATORS = 2,
  RETRY_MS = 60000,
};

static const char *const models[MODELS] = {"better", "classical"};
static const dipole_medium media[MEDIA] = {
    {.sigma_a_per_mm = 0.032, .sigma_s_per_mm = 0.74, .g = 0, .eta = 1.3},
    {.sigma_a_per_mm = 0.002, .sigma_s_per_mm = 2.55, .g = 0, .eta = 1.5}};

static core_profile profiles[MODELS][MEDIA][EVALUATORS];

/* A request, and the memory for its values. */
typedef struct slot {
  unsigned model, medium, evaluator;
  size_t count;
  _Alignas(double) uint8_t radii[RADII_MAX * sizeof(double)];
  _Alignas(double) uint8_t values[RADII_MAX * sizeof(double)];
  bool in_place;
} slot;

typedef struct worker {
  pthread_t thread;
  const char *address;
  uint64_t first, count; /* the thread sends the requests first, ..., first + count - 1 */
  uint64_t answered;
  uint64_t random;
  unsigned model_ids[MODELS];
  dipole_client *client;
  /* The slots order[0], ..., order[used - 1] are in use, for the requests with these ids. */
  size_t used;
  size_t order[IN_FLIGHT];
  uint64_t ids[IN_FLIGHT];
  slot slots[IN_FLIGHT];
} worker;

static _Noreturn void fail(const char *what, const dipole_error *error) {
  fprintf(stderr, "pipeline: %s%s%s\n", what, error != NULL ? ": " : "",
          error != NULL ? error->text : "");
  exit(1);
}

/* ---- requests ------------------------------------------------------------------------------ */

/* Makes the radii of a request. Up to 15 million requests have different first radii, even in
 * single precision. */
static void make_radii(slot *to, uint64_t number) {
  for (size_t i = 0; i < to->count; i++) {
    const double r = 0.5 + 0x1p-21 * (double)(number % (15 << 20)) + (double)i;
    if (to->evaluator == 0) {
      ((double *)(void *)to->radii)[i] = r;
    } else {
      ((float *)(void *)to->radii)[i] = (float)r;
    }
  }
}

static void submit(worker *of, uint64_t number) {
  slot *to = &of->slots[of->order[of->used]];
  const uint64_t random = core_splitmix(&of->random);
  dipole_error error;
  to->model = random % MODELS;
  to->medium = random / 16 % MEDIA;
  to->evaluator = random / 256 % EVALUATORS;
  to->count = 1 + random / 4096 % RADII_MAX;
  to->in_place = random / 65536 % 2 != 0;
  make_radii(to, number);
  memset(to->values, 0xff, sizeof to->values);
  const dipole_query query = {.model = of->model_ids[to->model],
                              .evaluator = to->evaluator == 0 ? DIPOLE_F64 : DIPOLE_F32,
                              .moments = DIPOLE_EXACT,
                              .wanted = DIPOLE_R,
                              .media = &media[to->medium],
                              .medium_count = 1,
                              .spacing = DIPOLE_LIST,
                              .radii = to->radii,
                              .radius_count = to->count,
                              .into_values = to->in_place ? to->values : NULL};
  if (!dipole_submit(of->client, &query, &of->ids[of->used], &error)) {
    fail("submit", &error);
  }
  of->used++;
}

/* ---- answers ------------------------------------------------------------------------------- */

static void check(const slot *asked, const dipole_result *result) {
  const core_profile *profile = &profiles[asked->model][asked->medium][asked->evaluator];
  double f64[RADII_MAX];
  float f32[RADII_MAX];
  const void *known = f64, *values = result->channels[0].R_f64;
  size_t bytes = asked->count * sizeof *f64;
  if (asked->evaluator == 0) {
    core_eval_f64(profile, CORE_QUANTITY_R, asked->count,
                  (const double *)(const void *)asked->radii, f64);
  } else {
    core_eval_f32(profile, CORE_QUANTITY_R, asked->count, (const float *)(const void *)asked->radii,
                  f32);
    known = f32;
    values = result->channels[0].R_f32;
    bytes = asked->count * sizeof *f32;
  }
  if (result->radius_count != asked->count || values == NULL || memcmp(values, known, bytes) != 0 ||
      (asked->in_place && memcmp(asked->values, known, bytes) != 0)) {
    fail("a wrong answer", NULL);
  }
}

/* Finds the slot of the request with this id, frees it and returns it. */
static const slot *take(worker *of, uint64_t id) {
  for (size_t i = 0; i < of->used; i++) {
    if (of->ids[i] == id) {
      const size_t found = of->order[i];
      of->used--;
      of->ids[i] = of->ids[of->used];
      of->order[i] = of->order[of->used];
      of->order[of->used] = found;
      return &of->slots[found];
    }
  }
  fail("an answer to nothing, or a second one", NULL);
}

/* Collects and checks one answer: half of the time that with a random id, else any. */
static void collect(worker *of) {
  const uint64_t random = core_splitmix(&of->random);
  dipole_result *result;
  dipole_error error;
  uint64_t id = of->ids[random / 2 % of->used];
  const bool good = random % 2 == 0 ? dipole_collect(of->client, &id, &result, &error)
                                    : dipole_collect_id(of->client, id, &result, &error);
  if (!good) {
    fail("collect", &error);
  }
  check(take(of, id), result);
  dipole_result_free(result);
  of->answered++;
}

/* ---- threads ------------------------------------------------------------------------------- */

static void open_client(worker *of) {
  dipole_options options;
  dipole_error error;
  dipole_options_init(&options);
  options.retry_ms = RETRY_MS;
  options.in_flight_max = IN_FLIGHT;
  options.spread = true;
  if (!dipole_open_with(of->address, &options, &of->client, &error)) {
    fail("open", &error);
  }
  for (size_t i = 0; i < MODELS; i++) {
    of->model_ids[i] = dipole_id(of->client, DIPOLE_MODEL, models[i]);
  }
}

/* The work of a thread: again and again submits queries until IN_FLIGHT are outstanding, and
 * collects a random number of answers. At the end it collects all answers. */
static void *work(void *argument) {
  worker *of = argument;
  uint64_t submitted = 0;
  open_client(of);
  for (size_t i = 0; i < IN_FLIGHT; i++) {
    of->order[i] = i;
  }
  while (of->answered < of->count) {
    while (of->used < IN_FLIGHT && submitted < of->count) {
      submit(of, of->first + submitted++);
    }
    const size_t least =
        submitted < of->count ? (size_t)(core_splitmix(&of->random) % of->used) : 0;
    while (of->used > least) {
      collect(of);
    }
  }
  if (submitted != of->count || dipole_outstanding(of->client) != 0) {
    fail("more answers than requests", NULL);
  }
  dipole_close(of->client);
  return NULL;
}

static uint64_t work_all(const char *address, uint64_t requests) {
  worker *workers = calloc(THREADS, sizeof *workers);
  uint64_t answered = 0;
  for (size_t i = 0; i < THREADS; i++) {
    worker *one = &workers[i];
    one->address = address;
    one->first = requests * i / THREADS;
    one->count = requests * (i + 1) / THREADS - one->first;
    one->random = i;
    if (pthread_create(&one->thread, NULL, work, one) != 0) {
      fail("no thread", NULL);
    }
  }
  for (size_t i = 0; i < THREADS; i++) {
    pthread_join(workers[i].thread, NULL);
    answered += workers[i].answered;
  }
  free(workers);
  return answered;
}

static void prepare_profiles(void) {
  static const unsigned evaluators[EVALUATORS] = {CORE_EVALUATOR_F64, CORE_EVALUATOR_F32};
  static const unsigned ids[MODELS] = {CORE_MODEL_BETTER, CORE_MODEL_CLASSICAL};
  for (size_t m = 0; m < MODELS; m++) {
    for (size_t k = 0; k < MEDIA; k++) {
      const core_medium medium = {media[k].sigma_a_per_mm, media[k].sigma_s_per_mm, media[k].g,
                                  media[k].eta};
      for (size_t e = 0; e < EVALUATORS; e++) {
        if (core_profile_prepare(&profiles[m][k][e], core_isa_select(NULL), ids[m],
                                 CORE_MOMENTS_EXACT, evaluators[e], &medium, NULL)
                .field != NULL) {
          fail("a profile was refused", NULL);
        }
      }
    }
  }
}

static double now_s(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + (double)now.tv_nsec / 1e9;
}

int main(int argc, char **argv) {
  const uint64_t requests = argc > 1 ? strtoull(argv[1], NULL, 10) : 0;
  if (requests == 0 || argc != 3) {
    fail("usage: pipeline REQUESTS ADDRESS", NULL);
  }
  prepare_profiles();
  const double start_s = now_s();
  const uint64_t answered = work_all(argv[2], requests);
  const double took_s = now_s() - start_s;
  printf("answered=%llu threads=%d in_flight=%d seconds=%.1f requests_per_s=%.0f\n",
         (unsigned long long)answered, THREADS, IN_FLIGHT, took_s, (double)answered / took_s);
  return answered == requests ? 0 : 1;
}
