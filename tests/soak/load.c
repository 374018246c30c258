/* soak-load ADDRESS SEED all|evals: sends a dipoled every kind of request through libdipole, as
 * fast as it answers, until standard input ends. It first sends each request alone, and compares
 * every later answer with that first one, bit for bit. It prints "answered=N" from time to time and
 * all counts at the end. It exits with 1 at the first answer that is wrong, doubled or missing. The
 * daemon may be killed and started again meanwhile. With `evals` it sends no Monte Carlo jobs,
 * breaks off no answer, and uses only models that prepare quickly. */
#include <math.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "clients/c/dipole.h"
#include "core/splitmix.h"

enum {
  QUESTIONS_MAX = 512,
  VARIANTS = 3, /* how many media each model gets */
  FEW = 16,
  MANY = 65536,
  PARTS = 2000000, /* radii of an answer that is too large for one frame of the daemon under test */
  IN_FLIGHT = 24,
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
static uint64_t answered, late, tables, jobs, broken_off;

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

static void check(const question *asked, dipole_result *result) {
  size_t count;
  uint8_t *bytes = bytes_of(result, &count);
  if (count != asked->known_bytes || memcmp(bytes, asked->known, count) != 0) {
    fail("a wrong answer", NULL);
  }
  free(bytes);
  dipole_result_free(result);
  answered++;
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
  for (size_t variant = 0; variant < (evaluator == DIPOLE_LUT ? 1 : VARIANTS); variant++) {
    const question asked = {
        .media = {medium_number(variant), medium_number(variant + 1)},
        .query = {.model = model,
                  .evaluator = evaluator,
                  .moments = DIPOLE_EXACT,
                  .wanted = DIPOLE_R | DIPOLE_ALBEDO | (variant == 1 ? DIPOLE_CDF : 0),
                  .medium_count = 1 + (variant == 2),
                  .spacing = DIPOLE_LIST,
                  .radii = single ? (const void *)radii_f32 : radii_f64,
                  .radius_count = FEW - variant}};
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
  for (unsigned evaluator = DIPOLE_F64; evaluator <= DIPOLE_LUT; evaluator++) {
    learn_grid(client, "better", evaluator, MANY);
  }
  learn_grid(client, "classical", DIPOLE_F32, PARTS);
}

/* ---- asking -------------------------------------------------------------------------------- */

typedef struct slot {
  uint64_t id; /* 0: free */
  const question *question;
  bool may_be_late;
} slot;

static const question *choose(uint64_t *random) {
  /* The last question is large. If it were as frequent as the others, it would take all the time.
   */
  const uint64_t which = core_splitmix(random) % (64 * question_count);
  return which == 0 ? &questions[question_count - 1] : &questions[which % (question_count - 1)];
}

static void submit(dipole_client *client, slot *to, uint64_t *random) {
  dipole_error error;
  to->question = choose(random);
  to->may_be_late = core_splitmix(random) % 8 == 0;
  dipole_query query = to->question->query;
  query.deadline_ms = to->may_be_late ? 1 + (uint32_t)(core_splitmix(random) % 20) : 0;
  if (!dipole_submit(client, &query, &to->id, &error)) {
    fail("submit", &error);
  }
}

static void collect(dipole_client *client, slot slots[IN_FLIGHT]) {
  static unsigned deadline_status;
  dipole_result *result;
  dipole_error error;
  uint64_t id = 0;
  const bool good = dipole_collect(client, &id, &result, &error);
  if (!good && error.kind != DIPOLE_ERROR_REFUSED) {
    fail("collect", &error);
  }
  slot *from = slots;
  while (from < slots + IN_FLIGHT && from->id != id) {
    from++;
  }
  if (from == slots + IN_FLIGHT) {
    fail("an answer to nothing", NULL);
  }
  from->id = 0;
  if (good) {
    check(from->question, result);
    return;
  }
  if (deadline_status == 0) {
    deadline_status = dipole_id(client, DIPOLE_STATUS, "deadline");
  }
  if (error.status != deadline_status || !from->may_be_late) {
    fail("refused", &error);
  }
  late++;
}

/* Fetches a table, and compares it with the first one that was fetched. */
static void fetch_table(dipole_client *client) {
  static uint8_t *known;
  static size_t known_bytes;
  const dipole_table_query query = {.model = dipole_id(client, DIPOLE_MODEL, "better"),
                                    .moments = DIPOLE_EXACT,
                                    .medium = medium_number(7)};
  dipole_table *table;
  dipole_error error;
  if (!dipole_table_fetch(client, &query, &table, &error)) {
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
  tables++;
}

/* Runs a Monte Carlo job, and compares its result with that of the first job. libdipole does not
 * repeat jobs, so a temporary refusal is no failure. */
static void walk(dipole_client *client) {
  static double known[8];
  const dipole_mc_query query = {.medium = medium_number(0),
                                 .thickness_mm = INFINITY,
                                 .spacing = DIPOLE_LINEAR,
                                 .ring_count = 8,
                                 .radius_stop_mm = 8,
                                 .seed = 5,
                                 .photons = 20000};
  dipole_mc_result *result;
  dipole_error error;
  if (!dipole_mc(client, &query, NULL, NULL, &result, &error)) {
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
  jobs++;
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

static void break_off(dipole_client *client) {
  unsigned parts = 0;
  dipole_error error;
  if (dipole_eval_parts(client, &questions[question_count - 1].query, read_two_parts, &parts,
                        &error) ||
      error.kind != DIPOLE_ERROR_STOPPED) {
    fail("parts", &error);
  }
  broken_off++;
}

static bool input_ended(void) {
  struct pollfd input = {.fd = 0, .events = POLLIN};
  return poll(&input, 1, 0) > 0;
}

static dipole_client *open_client(const char *address) {
  dipole_client *client;
  dipole_error error;
  if (!dipole_open(address, &client, &error)) {
    fail("open", &error);
  }
  dipole_set_retry_ms(client, RETRY_MS);
  dipole_set_timeout_ms(client, SILENCE_MS);
  return client;
}

int main(int argc, char **argv) {
  if (argc != 4) {
    fail("soak-load ADDRESS SEED all|evals", NULL);
  }
  uint64_t random = strtoull(argv[2], NULL, 10);
  const bool all = strcmp(argv[3], "all") == 0;
  slot slots[IN_FLIGHT] = {0};
  dipole_client *client = open_client(argv[1]);
  learn_all(client, !all);
  printf("questions=%zu\n", question_count);
  fflush(stdout);
  for (uint64_t round = 0; !input_ended(); round++) {
    for (size_t i = 0; i < IN_FLIGHT; i++) {
      if (slots[i].id == 0) {
        submit(client, &slots[i], &random);
      }
    }
    for (unsigned i = 0; i < IN_FLIGHT / 2; i++) {
      collect(client, slots);
    }
    if (round % 64 == 1) {
      fetch_table(client);
      printf("answered=%llu\n", (unsigned long long)answered);
      fflush(stdout);
    }
    if (all && round % 256 == 2) {
      walk(client);
    }
    if (all && round % 256 == 3) {
      break_off(client);
    }
  }
  dipole_close(client);
  printf("answered=%llu late=%llu tables=%llu jobs=%llu broken_off=%llu\n",
         (unsigned long long)answered, (unsigned long long)late, (unsigned long long)tables,
         (unsigned long long)jobs, (unsigned long long)broken_off);
  return 0;
}
