/* soak-load ADDRESS SEED all|evals|short [REQUESTS]: sends a dipoled every kind of request through
 * libdipole, as fast as it answers, until standard input ends. It first sends each request alone, and
 * compares every later answer with that first one, bit for bit; answers are collected in random order,
 * some by id, some in the order of arrival, some into memory of their own. It prints "answered=N" from
 * time to time and all counts at the end. It exits with 1 at the first answer that is wrong, doubled or
 * missing. The daemon may be killed and started again meanwhile, and ADDRESS may name several. With
 * `evals` it sends no Monte Carlo jobs, breaks off no answer, and uses only models that prepare
 * quickly. With `short` eight threads, each with a connection and 256 requests outstanding, send
 * REQUESTS evals of a few radii. */
#include <math.h>
#include <poll.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "clients/c/dipole.h"
#include "core/splitmix.h"

enum {
  QUESTIONS_MAX = 512,
  VARIANTS = 3, /* how many media each model gets */
  VARIANTS_SHORT = 80,
  FEW = 16,
  MANY = 65536,
  PARTS = 2000000, /* radii of an answer that is too large for one frame of the daemon under test */
  IN_FLIGHT = 24,
  IN_FLIGHT_SHORT = 256,
  THREADS_SHORT = 8,
  RETRY_MS = 60000,
  SILENCE_MS = 240000, /* a daemon with a sanitizer on a loaded machine may be slow */
};

/* A request and the bytes of its first answer. */
typedef struct question {
  dipole_query query;
  dipole_medium media[2];
  dipole_parameter parameters[4];
  uint8_t *known;
  size_t known_bytes;
} question;

static float radii_f32[FEW];
static double radii_f64[FEW];
static question questions[QUESTIONS_MAX];
static size_t question_count;
static bool is_short;

/* A request that is outstanding. */
typedef struct slot {
  uint64_t id; /* 0: free */
  const question *question;
  bool may_be_late, in_place;
  _Alignas(double) uint8_t values[2 * 2 * FEW * sizeof(double)]; /* in_place: its arrays */
} slot;

/* What a thread does over its connection. */
typedef struct worker {
  pthread_t thread;
  dipole_client *client;
  uint64_t random, submitted, requests; /* requests: how many it sends; 0: until input ends */
  uint64_t answered, late, tables, jobs, broken_off;
  size_t in_flight;
  bool all;
  slot slots[IN_FLIGHT_SHORT];
} worker;

static _Noreturn void fail(const char *what, const dipole_error *error) {
  fprintf(stderr, "soak-load: %s%s%s\n", what, error != NULL ? ": " : "",
          error != NULL ? error->text : "");
  exit(1);
}

/* ---- answers as bytes ---------------------------------------------------------------------- */

static void append(uint8_t **bytes, size_t *count, const void *more, size_t more_count) {
  uint8_t *larger = realloc(*bytes, *count + more_count + 1);
  if (larger == NULL) {
    fail("out of memory", NULL);
  }
  if (more_count > 0) {
    memcpy(larger + *count, more, more_count);
  }
  *bytes = larger;
  *count += more_count;
}

/* Returns all fields of an answer as bytes, which the caller frees. */
static uint8_t *bytes_of(const dipole_result *result, size_t *count) {
  const unsigned quantities[] = {DIPOLE_R, DIPOLE_CDF, DIPOLE_PDF};
  const unsigned head[] = {result->model, result->evaluator, result->moments, result->wanted,
                           result->notes};
  uint8_t *bytes = NULL;
  *count = 0;
  append(&bytes, count, head, sizeof head);
  append(&bytes, count, &result->radius_count, sizeof result->radius_count);
  for (uint32_t c = 0; c < result->channel_count; c++) {
    append(&bytes, count, &result->channels[c].albedo, sizeof(double));
    append(&bytes, count, &result->channels[c].model_error, sizeof(double));
    for (size_t q = 0; q < sizeof quantities / sizeof quantities[0]; q++) {
      const double *f64 = dipole_values_f64(result, c, quantities[q]);
      const float *f32 = dipole_values_f32(result, c, quantities[q]);
      if (f64 != NULL) {
        append(&bytes, count, f64, result->radius_count * sizeof *f64);
      } else if (f32 != NULL) {
        append(&bytes, count, f32, result->radius_count * sizeof *f32);
      }
    }
  }
  return bytes;
}

/* Whether the arrays of a result stand in the caller's memory, too. */
static bool is_in_place(const slot *from, const dipole_result *result) {
  const unsigned quantities[] = {DIPOLE_R, DIPOLE_CDF};
  const uint8_t *at = from->values;
  for (uint32_t c = 0; c < result->channel_count; c++) {
    for (size_t q = 0; q < sizeof quantities / sizeof quantities[0]; q++) {
      const void *f64 = dipole_values_f64(result, c, quantities[q]);
      const void *values = f64 != NULL ? f64 : dipole_values_f32(result, c, quantities[q]);
      const size_t bytes = result->radius_count * (f64 != NULL ? sizeof(double) : sizeof(float));
      if (values != NULL && memcmp(at, values, bytes) != 0) {
        return false;
      }
      at += values != NULL ? bytes : 0;
    }
  }
  return true;
}

static void check(worker *of, const slot *from, dipole_result *result) {
  size_t count;
  uint8_t *bytes = bytes_of(result, &count);
  if (count != from->question->known_bytes || memcmp(bytes, from->question->known, count) != 0 ||
      (from->in_place && !is_in_place(from, result))) {
    fail("a wrong answer", NULL);
  }
  free(bytes);
  dipole_result_free(result);
  of->answered++;
}

/* ---- questions ----------------------------------------------------------------------------- */

/* Adds a parameter, which a refusal has named, to a query. Returns false if there is no such
 * parameter. */
static bool add_parameter(const dipole_client *client, question *asked, const char *name) {
  const unsigned id = dipole_id(client, DIPOLE_PARAMETER, name);
  const size_t count = asked->query.parameter_count;
  if (id == 0 || count == sizeof asked->parameters / sizeof asked->parameters[0]) {
    return false;
  }
  const double value =
      strcmp(name, "fit_model") == 0 ? (double)dipole_id(client, DIPOLE_MODEL, "better") : 0.5;
  asked->parameters[count] = (dipole_parameter){.id = id, .value = value};
  asked->query.parameters = asked->parameters;
  asked->query.parameter_count = count + 1;
  return true;
}

/* Sends a request alone, and keeps it together with its answer. Forgets it if it is refused. */
static void learn(dipole_client *client, const question *from) {
  question *asked = &questions[question_count];
  dipole_result *result;
  dipole_error error;
  *asked = *from;
  asked->query.media = asked->media;
  while (!dipole_eval(client, &asked->query, &result, &error)) {
    if (error.kind != DIPOLE_ERROR_REFUSED) {
      fail("at first", &error);
    }
    if (!add_parameter(client, asked, error.field)) {
      return;
    }
  }
  asked->known = bytes_of(result, &asked->known_bytes);
  dipole_result_free(result);
  question_count += question_count + 1 < QUESTIONS_MAX;
}

static dipole_medium medium_number(size_t variant) {
  return (dipole_medium){
      .sigma_a_per_mm = 0.02 + 0.01 * (double)variant, .sigma_s_per_mm = 1, .g = 0, .eta = 1.3};
}

static void learn_model(dipole_client *client, unsigned model, unsigned evaluator) {
  const bool single = evaluator != DIPOLE_F64;
  const size_t variants = evaluator == DIPOLE_LUT ? 1 : is_short ? VARIANTS_SHORT : VARIANTS;
  for (size_t variant = 0; variant < variants; variant++) {
    const question asked = {
        .media = {medium_number(variant), medium_number(variant + 1)},
        .query = {.model = model,
                  .evaluator = evaluator,
                  .moments = DIPOLE_EXACT,
                  .wanted = DIPOLE_R | DIPOLE_ALBEDO | (variant % 3 == 1 ? DIPOLE_CDF : 0),
                  .medium_count = 1 + (variant % 3 == 2),
                  .spacing = DIPOLE_LIST,
                  .radii = single ? (const void *)radii_f32 : radii_f64,
                  .radius_count = FEW - variant % FEW}};
    learn(client, &asked);
  }
}

static void learn_grid(dipole_client *client, const char *model, unsigned evaluator,
                       uint64_t count) {
  const question asked = {.media = {medium_number(0)},
                          .query = {.model = dipole_id(client, DIPOLE_MODEL, model),
                                    .evaluator = evaluator,
                                    .moments = DIPOLE_EXACT,
                                    .wanted = DIPOLE_R,
                                    .medium_count = 1,
                                    .spacing = DIPOLE_LINEAR,
                                    .radius_start_mm = 0.1,
                                    .radius_stop_mm = 10,
                                    .radius_count = count}};
  learn(client, &asked);
}

/* Returns whether a model prepares quickly. Only such models are used while daemons are killed. */
static bool is_quick(const char *model) {
  return strcmp(model, "better") == 0 || strcmp(model, "classical") == 0;
}

static void learn_all(dipole_client *client, bool quick_only) {
  const dipole_info *info = dipole_get_info(client);
  for (size_t i = 0; i < FEW; i++) {
    radii_f32[i] = 0.25F * (float)(i + 1);
    radii_f64[i] = 0.25 * (double)(i + 1);
  }
  for (size_t i = 0; i < info->choice_count; i++) {
    if (info->choices[i].kind == DIPOLE_MODEL && (!quick_only || is_quick(info->choices[i].name))) {
      for (unsigned evaluator = DIPOLE_F64; evaluator <= DIPOLE_LUT; evaluator++) {
        learn_model(client, info->choices[i].id, evaluator);
      }
    }
  }
  for (unsigned evaluator = DIPOLE_F64; !is_short && evaluator <= DIPOLE_LUT; evaluator++) {
    learn_grid(client, "better", evaluator, MANY);
  }
  learn_grid(client, "classical", DIPOLE_F32, is_short ? FEW : PARTS);
}

/* ---- requests ------------------------------------------------------------------------------ */

static const question *choose(uint64_t *random) {
  /* The last question is large. If it were as frequent as the others, it would take all the time.
   */
  const uint64_t which = core_splitmix(random) % (64 * question_count);
  return which == 0 ? &questions[question_count - 1] : &questions[which % (question_count - 1)];
}

static void submit(worker *of, slot *to) {
  dipole_error error;
  to->question = choose(&of->random);
  to->may_be_late = !is_short && core_splitmix(&of->random) % 8 == 0;
  dipole_query query = to->question->query;
  query.deadline_ms = to->may_be_late ? 1 + (uint32_t)(core_splitmix(&of->random) % 20) : 0;
  to->in_place = query.radius_count <= FEW && core_splitmix(&of->random) % 2 != 0;
  query.into_values = to->in_place ? to->values : NULL;
  memset(to->values, 0xff, sizeof to->values);
  if (!dipole_submit(of->client, &query, &to->id, &error)) {
    fail("submit", &error);
  }
  of->submitted++;
}

/* Submits requests until in_flight are outstanding, or all have been sent. */
static void fill(worker *of) {
  for (size_t i = 0; i < of->in_flight; i++) {
    if (of->slots[i].id == 0 && (of->requests == 0 || of->submitted < of->requests)) {
      submit(of, &of->slots[i]);
    }
  }
}

/* Collects and checks one answer: half of the time that with a random id, else any. */
static void collect(worker *of) {
  dipole_result *result;
  dipole_error error;
  const uint64_t random = core_splitmix(&of->random);
  uint64_t id = of->slots[random / 2 % of->in_flight].id;
  const bool good = random % 2 == 0 && id != 0 ? dipole_collect_id(of->client, id, &result, &error)
                                               : dipole_collect(of->client, &id, &result, &error);
  if (!good && error.kind != DIPOLE_ERROR_REFUSED) {
    fail("collect", &error);
  }
  slot *from = of->slots;
  while (from < of->slots + of->in_flight && from->id != id) {
    from++;
  }
  if (from == of->slots + of->in_flight) {
    fail("an answer to nothing, or a second one", NULL);
  }
  from->id = 0;
  if (good) {
    check(of, from, result);
    return;
  }
  if (error.status != dipole_id(of->client, DIPOLE_STATUS, "deadline") || !from->may_be_late) {
    fail("refused", &error);
  }
  of->late++;
}

/* Fetches a table, and compares it with the first one that was fetched. */
static void fetch_table(worker *of) {
  static uint8_t *known;
  static size_t known_bytes;
  const dipole_table_query query = {.model = dipole_id(of->client, DIPOLE_MODEL, "better"),
                                    .moments = DIPOLE_EXACT,
                                    .medium = medium_number(7)};
  dipole_table *table;
  dipole_error error;
  if (!dipole_table_fetch(of->client, &query, &table, &error)) {
    fail("table", &error);
  }
  const dipole_table_info *info = dipole_table_get_info(table);
  const size_t bytes = info->word_count * sizeof *info->words;
  if (known == NULL) {
    append(&known, &known_bytes, info->words, bytes);
  } else if (bytes != known_bytes || memcmp(info->words, known, bytes) != 0) {
    fail("a wrong table", NULL);
  }
  dipole_table_free(table);
  of->tables++;
}

/* Runs a Monte Carlo job, and compares its result with that of the first job. libdipole does not
 * repeat jobs, so a temporary refusal is no failure. */
static void walk(worker *of) {
  static double known[8];
  const dipole_mc_query query = {.medium = medium_number(0),
                                 .spacing = DIPOLE_LINEAR,
                                 .ring_count = 8,
                                 .radius_stop_mm = 8,
                                 .seed = 5,
                                 .photons = 20000};
  dipole_mc_result *result;
  dipole_error error;
  if (!dipole_mc(of->client, &query, NULL, NULL, &result, &error)) {
    if (error.kind != DIPOLE_ERROR_REFUSED || error.retry_after_ms == 0) {
      fail("mc", &error);
    }
    return;
  }
  const double *R = dipole_mc_values(result, 0, DIPOLE_MC_REFLECTED);
  if (known[0] == 0) { /* No job has run yet: R is never 0. */
    memcpy(known, R, sizeof known);
  } else if (memcmp(known, R, sizeof known) != 0) {
    fail("a wrong table of photons", NULL);
  }
  dipole_mc_result_free(result);
  of->jobs++;
}

/* Compares the first two parts of a long answer, and then ends the answer. */
static bool read_two_parts(void *context, const dipole_result *part, uint64_t radius_first) {
  unsigned *parts = context;
  const question *asked = &questions[question_count - 1];
  const size_t head_bytes =
      asked->known_bytes -
      asked->query.radius_count * sizeof(float); /* The values of R are the last bytes. */
  if (memcmp(part->channels[0].R_f32, asked->known + head_bytes + radius_first * sizeof(float),
             part->radius_count * sizeof(float)) != 0) {
    fail("a wrong part", NULL);
  }
  return ++*parts < 2;
}

static void break_off(worker *of) {
  unsigned parts = 0;
  dipole_error error;
  if (dipole_eval_parts(of->client, &questions[question_count - 1].query, read_two_parts, &parts,
                        &error) ||
      error.kind != DIPOLE_ERROR_STOPPED) {
    fail("parts", &error);
  }
  of->broken_off++;
}

static bool input_ended(void) {
  struct pollfd input = {.fd = 0, .events = POLLIN};
  return poll(&input, 1, 0) > 0;
}

static dipole_client *open_client(const char *address) {
  dipole_client *client;
  dipole_options options;
  dipole_error error;
  dipole_options_init(&options);
  options.retry_ms = RETRY_MS;
  options.timeout_ms = SILENCE_MS;
  options.in_flight_max = IN_FLIGHT_SHORT;
  options.spread = true;
  if (!dipole_open_with(address, &options, &client, &error)) {
    fail("open", &error);
  }
  return client;
}

static void do_other_things(worker *of, uint64_t round) {
  if (round % 64 == 1) {
    fetch_table(of);
    printf("answered=%llu\n", (unsigned long long)of->answered);
    fflush(stdout);
  }
  if (of->all && round % 256 == 2) {
    walk(of);
  }
  if (of->all && round % 256 == 3) {
    break_off(of);
  }
}

/* Again and again submits requests until in_flight are outstanding, and collects some answers; at the
 * end those of all requests, if their number is given. */
static void *work(void *argument) {
  worker *of = argument;
  for (uint64_t round = 0; of->requests != 0 ? of->answered < of->requests : !input_ended();
       round++) {
    fill(of);
    const uint64_t some =
        is_short ? 1 + core_splitmix(&of->random) % of->in_flight : of->in_flight / 2;
    for (uint64_t i = 0; i < some && dipole_outstanding(of->client) > 0; i++) {
      collect(of);
    }
    if (!is_short) {
      do_other_things(of, round);
    }
  }
  if (of->requests != 0 && (of->answered != of->requests || dipole_outstanding(of->client) != 0)) {
    fail("more answers than requests", NULL);
  }
  dipole_close(of->client);
  return NULL;
}

int main(int argc, char **argv) {
  is_short = argc == 5 && strcmp(argv[3], "short") == 0;
  if (argc != 4 && !is_short) {
    fail("soak-load ADDRESS SEED all|evals|short [REQUESTS]", NULL);
  }
  static worker workers[THREADS_SHORT];
  const uint64_t threads = is_short ? THREADS_SHORT : 1;
  const uint64_t requests = is_short ? strtoull(argv[4], NULL, 10) : 0;
  worker sum = {.all = strcmp(argv[3], "all") == 0};
  dipole_client *client = open_client(argv[1]);
  learn_all(client, !sum.all);
  dipole_close(client);
  printf("questions=%zu\n", question_count);
  fflush(stdout);
  for (uint64_t i = 0; i < threads; i++) {
    workers[i] = (worker){.client = open_client(argv[1]),
                          .random = strtoull(argv[2], NULL, 10) + i,
                          .requests = requests * (i + 1) / threads - requests * i / threads,
                          .in_flight = is_short ? IN_FLIGHT_SHORT : IN_FLIGHT,
                          .all = sum.all};
    if (pthread_create(&workers[i].thread, NULL, work, &workers[i]) != 0) {
      fail("no thread", NULL);
    }
  }
  for (uint64_t i = 0; i < threads; i++) {
    pthread_join(workers[i].thread, NULL);
    sum.answered += workers[i].answered;
    sum.late += workers[i].late;
    sum.tables += workers[i].tables;
    sum.jobs += workers[i].jobs;
    sum.broken_off += workers[i].broken_off;
  }
  printf("answered=%llu late=%llu tables=%llu jobs=%llu broken_off=%llu\n",
         (unsigned long long)sum.answered, (unsigned long long)sum.late,
         (unsigned long long)sum.tables, (unsigned long long)sum.jobs,
         (unsigned long long)sum.broken_off);
  return 0;
}
