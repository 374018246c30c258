/* Surfaces in libdipole: those of other media, wrong queries and impossible facts are refused.
 * test_varying.py compares what they evaluate at home with the daemon, bit by bit. */
#include <math.h>

#include "proto/schema.h"
#include "proto/table.h"
#include "proto/varying.h"
#include "tests/unit/peer_scripts.h"
#include "tests/unit/unit.h"

/* ---- surfaces ------------------------------------------------------------------------------ */

/* What a surface is for, and its frame. */
typedef struct made_surface {
  core_varying varying;
  dipole_parameter parameter;
  core_parameters parameters;
  uint8_t *bytes;
  size_t count;
} made_surface;

static made_surface made;

static void put_frame(made_surface *surface) {
  const size_t payload_bytes =
      table_reply_bytes(&surface->parameters, table_surface_words(&surface->varying));
  const wire_header header = {.magic = WIRE_MAGIC,
                              .version = WIRE_VERSION,
                              .type = WIRE_TYPE_TABLE | WIRE_REPLY,
                              .request_id = 9,
                              .payload_bytes = (uint32_t)payload_bytes};
  surface->count = WIRE_BYTES_header + payload_bytes;
  surface->bytes = realloc(surface->bytes, surface->count);
  assert_non_null(surface->bytes);
  wire_put_header(surface->bytes, &header);
  table_reply_put_surface(surface->bytes + WIRE_BYTES_header, &surface->varying,
                          &surface->parameters);
}

UNIT_SETUP(make_surface) {
  made.parameter = (dipole_parameter){CORE_PARAMETER_TOLERANCE, 0.01};
  made.parameters = core_parameters_none();
  made.parameters.value[CORE_PARAMETER_TOLERANCE] = 0.01;
  unit_assert_fault(core_varying_prepare(&made.varying, core_isa_select(NULL), CORE_MODEL_TRANSPORT,
                                         CORE_MOMENTS_EXACT, CORE_EVALUATOR_F32, 0.8, 1.4,
                                         &made.parameters),
                    NULL, 0);
  put_frame(&made);
}

UNIT_TEARDOWN(free_surface) {
  core_varying_free(&made.varying);
  free(made.bytes);
}

static dipole_surface *load(void) {
  dipole_surface *surface;
  dipole_error error;
  peer_expect(dipole_surface_load(made.bytes, made.count, &surface, &error), &error);
  return surface;
}

/* ---- fetching ------------------------------------------------------------------------------ */

/* A script of a daemon that answers any request with the surface. */
static void serve(int fd, void *context) {
  peer_frame frame;
  (void)context;
  bool good = peer_say_hello(fd);
  while (good && peer_receive(fd, &frame)) {
    good = peer_send(fd, WIRE_TYPE_TABLE | WIRE_REPLY, frame.header.request_id,
                     made.bytes + WIRE_BYTES_header, made.count - WIRE_BYTES_header);
    free(frame.payload);
  }
}

static void assert_not_fetched(const dipole_table_query *query, enum dipole_error_kind kind) {
  scripted_peer peer;
  dipole_surface *surface = NULL;
  dipole_error error = {0};
  dipole_client *client = peer_begin(&peer, serve, NULL);
  assert_false(dipole_surface_fetch(client, query, &surface, &error));
  assert_int_equal(error.kind, kind);
  assert_null(surface);
  peer_finish(&peer, client);
}

UNIT_TEST(surfaces_of_something_else_are_refused) {
  const dipole_table_query right = {.model = CORE_MODEL_TRANSPORT,
                                    .moments = DIPOLE_EXACT,
                                    .medium = {0, 0, 0.8, 1.4},
                                    .parameters = &made.parameter,
                                    .parameter_count = 1};
  dipole_table_query others[6] = {right, right, right, right, right, right};
  const dipole_parameter looser = {CORE_PARAMETER_TOLERANCE, 0.02};
  others[0].model = CORE_MODEL_BETTER;
  others[1].moments = DIPOLE_FIT;
  others[2].medium.g = 0.7;
  others[3].medium.eta = 1.3;
  others[4].parameter_count = 0;
  others[5].parameters = &looser;
  for (size_t i = 0; i < 6; i++) {
    assert_not_fetched(&others[i], DIPOLE_ERROR_PROTOCOL);
  }
  others[0] = right;
  others[0].medium.sigma_s_per_mm = 1;
  assert_not_fetched(&others[0], DIPOLE_ERROR_ARGUMENT);
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
  static const float numbers[] = {0.5F, 1};
  dipole_surface *surface = load();
  const dipole_varying_query right = {.model = CORE_MODEL_TRANSPORT,
                                      .evaluator = DIPOLE_F32,
                                      .moments = DIPOLE_EXACT,
                                      .wanted = DIPOLE_R,
                                      .g = 0.8,
                                      .eta = 1.4,
                                      .sigma_a_per_mm = numbers,
                                      .sigma_s_per_mm = numbers,
                                      .radii = numbers,
                                      .value_count = 2,
                                      .parameters = &made.parameter,
                                      .parameter_count = 1};
  dipole_varying_result *result;
  assert_true(dipole_varying_at_home(surface, &right, &result, NULL));
  dipole_varying_result_free(result);
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

UNIT_TEST(impossible_facts_are_found) {
  made_surface *of = &made;
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
  WITH(layer_count, 0);
#undef WITH
  wire_put_table_reply(of->bytes + WIRE_BYTES_header, &right);
  static const core_medium media[] = {{1, 0, 0.8, 1.4}, {0, (double)NAN, 0.8, 1.4},
                                      {0, 0, 1, 1.4},   {0, 0, (double)NAN, 1.4},
                                      {0, 0, 0.8, 0},   {0, 0, 0.8, (double)NAN}};
  uint8_t *medium = of->bytes + WIRE_BYTES_header + WIRE_BYTES_table_reply;
  core_medium kept;
  memcpy(&kept, medium, sizeof kept);
  for (size_t i = 0; i < sizeof media / sizeof media[0]; i++) {
    memcpy(medium, &media[i], sizeof media[i]);
    assert_damaged(of->bytes, of->count);
  }
  memcpy(medium, &kept, sizeof kept);
  dipole_surface_free(load());
}
