/* Media that vary, in libdipole: what a client evaluates at home has the bits of a daemon, in parts
 * and in one frame; damaged surfaces, those of other media and wrong answers are refused. */
#include <math.h>

#include "proto/channels.h"
#include "proto/table.h"
#include "proto/varying.h"
#include "tests/unit/peer_scripts.h"
#include "tests/unit/unit.h"

/* ---- surfaces ------------------------------------------------------------------------------ */

enum { VALUES = 3000, MODELS = 2, EVALUATORS = 2 };

/* What a surface is for, and its frame. */
typedef struct made_surface {
  core_varying varying[EVALUATORS]; /* f64 and f32 */
  dipole_parameter parameter;
  core_parameters parameters;
  uint8_t *bytes;
  size_t count;
} made_surface;

static made_surface made[MODELS];

static void put_frame(made_surface *surface) {
  const size_t payload_bytes = table_reply_bytes(channels_count_parameters(&surface->parameters),
                                                 table_surface_words(&surface->varying[1]));
  const wire_header header = {.magic = WIRE_MAGIC,
                              .version = WIRE_VERSION,
                              .type = WIRE_TYPE_TABLE | WIRE_REPLY,
                              .request_id = 9,
                              .payload_bytes = (uint32_t)payload_bytes};
  surface->count = WIRE_BYTES_header + payload_bytes;
  surface->bytes = realloc(surface->bytes, surface->count);
  assert_non_null(surface->bytes);
  wire_put_header(surface->bytes, &header);
  table_reply_put_surface(surface->bytes + WIRE_BYTES_header, &surface->varying[1],
                          &surface->parameters);
}

UNIT_SETUP(make_surfaces) {
  static const unsigned models[MODELS] = {CORE_MODEL_TRANSPORT, CORE_MODEL_BETTER};
  for (size_t i = 0; i < MODELS; i++) {
    made[i].parameter = (dipole_parameter){CORE_PARAMETER_TOLERANCE, 0.01};
    made[i].parameters = core_parameters_none();
    made[i].parameters.value[CORE_PARAMETER_TOLERANCE] = 0.01;
    for (unsigned k = 0; k < EVALUATORS; k++) {
      unit_assert_fault(core_varying_prepare(&made[i].varying[k], core_isa_select(NULL), models[i],
                                             CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64 + k, 0.8, 1.4,
                                             &made[i].parameters),
                        NULL, 0);
    }
    put_frame(&made[i]);
  }
}

UNIT_TEARDOWN(free_surfaces) {
  for (size_t i = 0; i < MODELS; i++) {
    core_varying_free(&made[i].varying[0]);
    core_varying_free(&made[i].varying[1]);
    free(made[i].bytes);
  }
}

static dipole_surface *load(const made_surface *from) {
  dipole_surface *surface;
  dipole_error error;
  peer_expect(dipole_surface_load(from->bytes, from->count, &surface, &error), &error);
  return surface;
}

/* ---- queries ------------------------------------------------------------------------------- */

/* Numbers of all kinds, among them such as have no medium. */
static struct {
  double f64[5][VALUES];
  float f32[5][VALUES];
} numbers;

enum { SIGMA_A, SIGMA_S, COLOUR, RADIUS, U };

static void choose_numbers(void) {
  static const double wrong[] = {-1, (double)NAN, (double)INFINITY, 0, 2};
  uint64_t random = unit_seed();
  for (size_t i = 0; i < VALUES; i++) {
    numbers.f64[SIGMA_A][i] = unit_random_log(&random, 1e-4, 10);
    numbers.f64[SIGMA_S][i] = unit_random_log(&random, 1e-2, 100);
    numbers.f64[COLOUR][i] = unit_random_between(&random, 0, 1);
    numbers.f64[RADIUS][i] = unit_random_log(&random, 1e-3, 1e3);
    numbers.f64[U][i] = unit_random_between(&random, 0, 1);
    if (i % 16 == 0) {
      numbers.f64[unit_random_below(&random, 5)][i] = wrong[unit_random_below(&random, 5)];
    }
    for (size_t k = 0; k < 5; k++) {
      numbers.f32[k][i] = (float)numbers.f64[k][i];
    }
  }
}

static const void *array_of(unsigned evaluator, size_t which) {
  return evaluator == DIPOLE_F64 ? (const void *)numbers.f64[which]
                                 : (const void *)numbers.f32[which];
}

enum how { COEFFICIENTS, COLOURS, DRAWN, ALBEDOS, HOWS };

static dipole_varying_query make_query(const made_surface *of, unsigned evaluator, enum how how) {
  const bool coloured = how == COLOURS || how == ALBEDOS;
  return (dipole_varying_query){
      .model = of->varying[0].model,
      .evaluator = evaluator,
      .moments = DIPOLE_EXACT,
      .wanted = how == ALBEDOS ? DIPOLE_ALBEDO
                               : DIPOLE_R | DIPOLE_ALBEDO | DIPOLE_CDF | DIPOLE_PDF | DIPOLE_RING |
                                     (how == DRAWN ? DIPOLE_RADIUS : 0),
      .coefficients = DIPOLE_SIGMA_A | DIPOLE_SIGMA_S | DIPOLE_SCATTERED,
      .g = 0.8,
      .eta = 1.4,
      .sigma_a_per_mm = coloured ? NULL : array_of(evaluator, SIGMA_A),
      .sigma_s_per_mm = coloured ? NULL : array_of(evaluator, SIGMA_S),
      .colours = coloured ? array_of(evaluator, COLOUR) : NULL,
      .lengths_mm = coloured ? array_of(evaluator, SIGMA_S) : NULL,
      .given = coloured ? DIPOLE_MEAN_FREE_PATH : 0,
      .light = coloured ? DIPOLE_BEAM : 0,
      .specular = how == COLOURS,
      .radii = how == COEFFICIENTS || how == COLOURS ? array_of(evaluator, RADIUS) : NULL,
      .numbers = how == DRAWN ? array_of(evaluator, U) : NULL,
      .value_count = VALUES,
      .parameters = &of->parameter,
      .parameter_count = 1};
}

/* ---- a daemon ------------------------------------------------------------------------------ */

/* Answers of a peer: parts of so many values, in slices of so many. */
typedef struct service {
  const made_surface *surface;
  uint64_t part_values; /* 0: one frame */
  size_t slice_values;
  void (*spoil)(uint8_t *payload, uint32_t part); /* may be NULL */
} service;

static bool send_part(int fd, const service *with, const wire_header *header,
                      const varying_request *request, uint64_t first) {
  static double scratch[VARYING_SCRATCH_ARRAYS * VARYING_SLICE_VALUES];
  const wire_varying_request *fixed = &request->fixed;
  const core_varying *varying = &with->surface->varying[fixed->evaluator == CORE_EVALUATOR_F32];
  const uint64_t most = with->part_values != 0 ? with->part_values : fixed->value_count;
  const uint64_t left = fixed->value_count - first, count = left < most ? left : most;
  const varying_layout layout =
      varying_reply_layout(fixed->evaluator, fixed->wanted, fixed->coefficients, count);
  uint8_t *payload = malloc(layout.payload_bytes);
  varying_part part;
  if (payload == NULL) {
    abort();
  }
  varying_part_start(&part, request, payload, first, count);
  for (uint64_t at = 0; at < count; at += with->slice_values) {
    const uint64_t rest = count - at;
    varying_part_evaluate(&part, request, varying, NULL, at,
                          rest < with->slice_values ? (size_t)rest : with->slice_values, scratch);
  }
  const uint32_t number = (uint32_t)(first / most);
  varying_part_end(&part, request, varying, NULL, number,
                   (uint32_t)((fixed->value_count - 1) / most + 1));
  if (with->spoil != NULL) {
    with->spoil(payload, number);
  }
  const bool good = peer_send(fd, WIRE_TYPE_VARYING | WIRE_REPLY, header->request_id, payload,
                              (size_t)layout.payload_bytes);
  free(payload);
  return good;
}

static void serve(int fd, void *context) {
  const service *with = context;
  peer_frame frame;
  bool good = peer_say_hello(fd);
  while (good && peer_receive(fd, &frame)) {
    varying_request request;
    if (frame.header.type == WIRE_TYPE_TABLE) {
      good = peer_send(fd, WIRE_TYPE_TABLE | WIRE_REPLY, frame.header.request_id,
                       with->surface->bytes + WIRE_BYTES_header,
                       with->surface->count - WIRE_BYTES_header);
    } else if (varying_request_parse(frame.payload, frame.header.payload_bytes, &request).status !=
               WIRE_STATUS_OK) {
      abort(); /* The library makes only well-formed requests. */
    } else {
      const uint64_t count = request.fixed.value_count;
      const uint64_t most = with->part_values != 0 ? with->part_values : count;
      for (uint64_t first = 0; good && first < count; first += most) {
        good = send_part(fd, with, &frame.header, &request, first);
      }
    }
    free(frame.payload);
  }
}

/* ---- the same bits ------------------------------------------------------------------------- */

static bool same(double a, double b) {
  return memcmp(&a, &b, sizeof a) == 0;
}

static void assert_same_arrays(const dipole_varying_result *a, const dipole_varying_result *b) {
  const size_t count = (size_t)a->value_count;
  for (unsigned bit = 1; bit <= DIPOLE_BY_SIGMA_S; bit <<= 1) {
    const double *x = dipole_varying_f64(a, bit), *y = dipole_varying_f64(b, bit);
    const float *p = dipole_varying_f32(a, bit), *q = dipole_varying_f32(b, bit);
    const double *c = dipole_coefficients_f64(a, bit), *d = dipole_coefficients_f64(b, bit);
    const float *e = dipole_coefficients_f32(a, bit), *f = dipole_coefficients_f32(b, bit);
    assert_int_equal((x != NULL) + (p != NULL), (a->wanted & bit) != 0);
    assert_int_equal((c != NULL) + (e != NULL), (a->coefficients & bit) != 0);
    assert_true((x == NULL) == (y == NULL) && (p == NULL) == (q == NULL));
    assert_true((c == NULL) == (d == NULL) && (e == NULL) == (f == NULL));
    assert_true(x == NULL || memcmp(x, y, count * sizeof *x) == 0);
    assert_true(p == NULL || memcmp(p, q, count * sizeof *p) == 0);
    assert_true(c == NULL || memcmp(c, d, count * sizeof *c) == 0);
    assert_true(e == NULL || memcmp(e, f, count * sizeof *e) == 0);
  }
  assert_memory_equal(a->statuses, b->statuses, count);
}

/* A whole answer and one in parts may differ only in their errors, which are of other ranges. */
static void assert_same_answers(const dipole_varying_result *a, const dipole_varying_result *b,
                                bool whole) {
  assert_int_equal(a->value_count, b->value_count);
  assert_int_equal(a->computed_count, b->computed_count);
  assert_true(a->model == b->model && a->evaluator == b->evaluator && a->moments == b->moments &&
              a->wanted == b->wanted && a->coefficients == b->coefficients && a->notes == b->notes);
  assert_true(same(a->colour_least, b->colour_least) && same(a->colour_most, b->colour_most) &&
              same(a->specular, b->specular));
  assert_true(whole ? same(a->numerical_error, b->numerical_error)
                    : b->numerical_error > 0 && b->numerical_error <= a->numerical_error);
  assert_true(!whole || same(a->model_error, b->model_error));
  assert_same_arrays(a, b);
}

static dipole_varying_result *at_home(const dipole_surface *surface,
                                      const dipole_varying_query *query) {
  dipole_varying_result *result;
  dipole_error error;
  peer_expect(dipole_varying_at_home(surface, query, &result, &error), &error);
  return result;
}

static void assert_answered(const dipole_varying_result *result) {
  uint64_t answered = 0;
  for (size_t i = 0; i < result->value_count; i++) {
    answered += result->statuses[i] == DIPOLE_VALUE_OK || result->statuses[i] == DIPOLE_VALUE_FAR;
  }
  assert_int_equal(result->value_count, VALUES);
  assert_int_equal(answered, result->computed_count);
  assert_true(answered > VALUES / 4 && answered < VALUES);
}

static void assert_as_a_daemon(const made_surface *of, uint64_t part_values, size_t slice_values) {
  service with = {of, part_values, slice_values, NULL};
  scripted_peer peer;
  dipole_surface *surface = load(of);
  dipole_client *client = peer_begin(&peer, serve, &with);
  for (unsigned evaluator = DIPOLE_F64; evaluator <= DIPOLE_F32; evaluator++) {
    for (enum how how = 0; how < HOWS; how++) {
      const dipole_varying_query query = make_query(of, evaluator, how);
      dipole_varying_result *home = at_home(surface, &query), *asked;
      dipole_error error;
      peer_expect(dipole_varying(client, &query, &asked, &error), &error);
      assert_answered(home);
      assert_same_answers(home, asked, part_values == 0);
      dipole_varying_result_free(asked);
      dipole_varying_result_free(home);
    }
  }
  peer_finish(&peer, client);
  dipole_surface_free(surface);
}

UNIT_TEST(at_home_the_bits_are_those_of_a_daemon) {
  choose_numbers();
  for (size_t i = 0; i < MODELS; i++) {
    assert_as_a_daemon(&made[i], 0, 256);
    assert_as_a_daemon(&made[i], 0, 2048);
  }
}

UNIT_TEST(parts_are_put_together) {
  choose_numbers();
  for (size_t i = 0; i < MODELS; i++) {
    assert_as_a_daemon(&made[i], 1024, 512);
    assert_as_a_daemon(&made[i], 256, 256);
  }
}

UNIT_TEST(no_values_are_an_answer) {
  dipole_surface *surface = load(&made[0]);
  dipole_varying_query query = make_query(&made[0], DIPOLE_F32, COEFFICIENTS);
  query.value_count = 0;
  dipole_varying_result *result = at_home(surface, &query);
  assert_true(result->value_count == 0 && result->computed_count == 0);
  dipole_varying_result_free(result);
  dipole_varying_result_free(NULL);
  dipole_surface_free(surface);
  dipole_surface_free(NULL);
}

/* ---- fetching and saving ------------------------------------------------------------------- */

static dipole_table_query surface_query(const made_surface *of) {
  return (dipole_table_query){.model = of->varying[0].model,
                              .moments = DIPOLE_EXACT,
                              .medium = {0, 0, 0.8, 1.4},
                              .parameters = &of->parameter,
                              .parameter_count = 1};
}

/* Fetches a surface from a peer. Returns NULL if the call fails, which must be with this kind. */
static dipole_surface *fetch(const made_surface *of, const dipole_table_query *query,
                             enum dipole_error_kind kind) {
  service with = {of, 0, VARYING_SLICE_VALUES, NULL};
  scripted_peer peer;
  dipole_surface *surface = NULL;
  dipole_error error = {0};
  dipole_client *client = peer_begin(&peer, serve, &with);
  const bool good = dipole_surface_fetch(client, query, &surface, &error);
  assert_int_equal(good, surface != NULL);
  assert_int_equal(error.kind, good ? DIPOLE_ERROR_NONE : kind);
  peer_finish(&peer, client);
  return surface;
}

UNIT_TEST(surfaces_are_fetched_and_saved) {
  choose_numbers();
  for (size_t i = 0; i < MODELS; i++) {
    size_t count;
    const dipole_table_query query = surface_query(&made[i]);
    dipole_surface *fetched = fetch(&made[i], &query, DIPOLE_ERROR_NONE), *again;
    assert_non_null(fetched);
    const uint8_t *bytes = dipole_surface_bytes(fetched, &count);
    assert_int_equal(count, made[i].count);
    uint8_t *file = malloc(count + 9); /* not aligned, and with something behind it */
    assert_non_null(file);
    memcpy(file + 1, bytes, count);
    assert_true(dipole_surface_load(file + 1, count + 8, &again, NULL));
    assert_memory_equal(dipole_surface_bytes(again, &count), bytes, made[i].count);
    const dipole_varying_query ask = make_query(&made[i], DIPOLE_F32, COLOURS);
    dipole_varying_result *a = at_home(fetched, &ask), *b = at_home(again, &ask);
    assert_same_answers(a, b, true);
    dipole_varying_result_free(a);
    dipole_varying_result_free(b);
    dipole_surface_free(fetched);
    dipole_surface_free(again);
    free(file);
  }
}

UNIT_TEST(surfaces_of_something_else_are_refused) {
  dipole_table_query others[6];
  for (size_t i = 0; i < 6; i++) {
    others[i] = surface_query(&made[0]);
  }
  const dipole_parameter looser = {CORE_PARAMETER_TOLERANCE, 0.02};
  others[0].model = CORE_MODEL_BETTER;
  others[1].moments = DIPOLE_FIT;
  others[2].medium.g = 0.7;
  others[3].medium.eta = 1.3;
  others[4].parameter_count = 0;
  others[5].parameters = &looser;
  for (size_t i = 0; i < 6; i++) {
    assert_null(fetch(&made[0], &others[i], DIPOLE_ERROR_PROTOCOL));
  }
  others[0] = surface_query(&made[0]);
  others[0].medium.sigma_s_per_mm = 1;
  assert_null(fetch(&made[0], &others[0], DIPOLE_ERROR_ARGUMENT));
}

/* ---- queries that are wrong ---------------------------------------------------------------- */

static void assert_refused(const dipole_surface *surface, const dipole_varying_query *query) {
  dipole_varying_result *result = NULL;
  dipole_error error = {0};
  assert_false(dipole_varying_at_home(surface, query, &result, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_ARGUMENT);
  assert_string_not_equal(error.text, "");
  assert_null(result);
}

UNIT_TEST(queries_of_other_media_are_refused) {
  const dipole_parameter other = {CORE_PARAMETER_TOLERANCE, 1e-3};
  const dipole_parameter two[] = {{CORE_PARAMETER_TOLERANCE, 0.01}, {CORE_PARAMETER_GAMMA, 1}};
  dipole_surface *surface = load(&made[0]);
  const dipole_varying_query right = make_query(&made[0], DIPOLE_F32, COEFFICIENTS);
#define WITH(field, value)                                                                         \
  do {                                                                                             \
    dipole_varying_query wrong = right;                                                            \
    wrong.field = (value);                                                                         \
    assert_refused(surface, &wrong);                                                               \
  } while (0)
  WITH(model, CORE_MODEL_BETTER);
  WITH(model, 0);
  WITH(moments, DIPOLE_FIT);
  WITH(g, 0);
  WITH(g, (double)NAN);
  WITH(eta, 1.3);
  WITH(parameters, &other);
  WITH(parameter_count, 0);
  WITH(evaluator, DIPOLE_LUT);
  WITH(wanted, DIPOLE_RADIUS);
  WITH(wanted, 1u << 14);
  WITH(coefficients, 8);
  WITH(sigma_a_per_mm, NULL);
  WITH(colours, right.sigma_a_per_mm);
  WITH(given, DIPOLE_MEAN_FREE_PATH);
  WITH(light, DIPOLE_BEAM);
  WITH(specular, true);
  WITH(radii, NULL);
  WITH(numbers, right.radii);
  WITH(value_count, UINT64_MAX);
#undef WITH
  dipole_varying_query wrong = right;
  wrong.parameters = two;
  wrong.parameter_count = 2;
  assert_refused(surface, &wrong);
  dipole_surface_free(surface);
}

/* ---- damage -------------------------------------------------------------------------------- */

static void assert_damaged(const uint8_t *bytes, size_t count) {
  dipole_surface *surface = NULL;
  dipole_error error = {0};
  assert_false(dipole_surface_load(bytes, count, &surface, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_TABLE);
  assert_string_not_equal(error.text, "");
  assert_null(surface);
}

UNIT_TEST(damaged_surfaces_are_found) {
  uint64_t random = unit_seed();
  for (size_t i = 0; i < MODELS; i++) {
    uint8_t *bytes = made[i].bytes;
    const size_t count = made[i].count, words_at = WIRE_BYTES_header + WIRE_BYTES_table_reply;
    for (size_t cut = 0; cut < count; cut += 1 + unit_random_below(&random, count / 50)) {
      assert_damaged(bytes, cut);
    }
    for (int k = 0; k < 100; k++) {
      const size_t at = words_at + WIRE_BYTES_parameter +
                        unit_random_below(&random, count - words_at - WIRE_BYTES_parameter);
      const uint8_t bit = (uint8_t)(1u << unit_random_below(&random, 8));
      bytes[at] ^= bit;
      assert_damaged(bytes, count);
      bytes[at] ^= bit;
    }
    dipole_surface_free(load(&made[i]));
  }
}

UNIT_TEST(impossible_facts_are_found) {
  made_surface *of = &made[0];
  wire_table_reply right, wrong;
  wire_get_table_reply(of->bytes + WIRE_BYTES_header, &right);
#define WITH(field, value)                                                                         \
  do {                                                                                             \
    wrong = right;                                                                                 \
    wrong.field = (value);                                                                         \
    wire_put_table_reply(of->bytes + WIRE_BYTES_header, &wrong);                                   \
    assert_damaged(of->bytes, of->count);                                                          \
  } while (0)
  WITH(layout, 1);
  WITH(model, 0);
  WITH(model, CORE_MODEL_GAUSSIANS);
  WITH(moments, 9);
  WITH(word_count, 0);
  WITH(word_count, UINT32_MAX);
  WITH(parameter_count, 65535);
  WITH(checksum, right.checksum + 1);
  WITH(sigma_a, 1);
  WITH(sigma_s, (double)NAN);
  WITH(g, 1);
  WITH(g, (double)NAN);
  WITH(eta, 0);
  WITH(eta, (double)NAN);
#undef WITH
  wire_put_table_reply(of->bytes + WIRE_BYTES_header, &right);
  dipole_surface_free(load(of));
}

/* ---- wrong answers ------------------------------------------------------------------------- */

#define SPOIL(name, when, change)                                                                  \
  static void name(uint8_t *payload, uint32_t part) {                                              \
    wire_varying_reply fixed;                                                                      \
    wire_get_varying_reply(payload, &fixed);                                                       \
    if (part == (when)) {                                                                          \
      change;                                                                                      \
      wire_put_varying_reply(payload, &fixed);                                                     \
    }                                                                                              \
  }

SPOIL(spoil_model, 0, fixed.model = CORE_MODEL_CLASSICAL)
SPOIL(spoil_evaluator, 0, fixed.evaluator = 3)
SPOIL(spoil_moments, 0, fixed.moments = DIPOLE_FIT)
SPOIL(spoil_wanted, 0, fixed.wanted ^= DIPOLE_R | DIPOLE_RADIUS)
SPOIL(spoil_coefficients, 0, fixed.coefficients = 3)
SPOIL(spoil_first, 1, fixed.first++)
SPOIL(spoil_part, 1, fixed.part++)
SPOIL(spoil_count, 1, fixed.count--)
SPOIL(spoil_answered, 1, fixed.computed_count = fixed.count + 1)
SPOIL(spoil_end, 1, fixed.part_count = 2)

UNIT_TEST(wrong_answers_are_refused) {
  void (*const spoils[])(uint8_t *, uint32_t) = {
      spoil_model, spoil_evaluator, spoil_moments, spoil_wanted,   spoil_coefficients,
      spoil_first, spoil_part,      spoil_count,   spoil_answered, spoil_end};
  choose_numbers();
  for (size_t i = 0; i < sizeof spoils / sizeof spoils[0]; i++) {
    service with = {&made[1], 1024, 1024, spoils[i]};
    scripted_peer peer;
    dipole_varying_result *result = NULL;
    dipole_error error = {0};
    dipole_client *client = peer_begin(&peer, serve, &with);
    const dipole_varying_query query = make_query(&made[1], DIPOLE_F32, COEFFICIENTS);
    assert_false(dipole_varying(client, &query, &result, &error));
    assert_int_equal(error.kind, DIPOLE_ERROR_PROTOCOL);
    assert_null(result);
    peer_finish(&peer, client);
  }
}
