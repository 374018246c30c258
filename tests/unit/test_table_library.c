/* Tables and surfaces of libdipole: the errors that tables state, what they do not hold, queries of
 * other media, impossible facts and wrong answers of a peer. test_tables.py, test_cli_table.py and
 * test_varying.py have their values, files and damage. */
#include <math.h>

#include "core/ruler.h"
#include "proto/table.h"
#include "proto/varying.h"
#include "tests/unit/peer_scripts.h"
#include "tests/unit/unit.h"

static const core_medium skin = {0.032, 0.74, 0, 1.3};
static const dipole_parameter given[] = {{CORE_PARAMETER_TOLERANCE, 0.01},
                                         {CORE_PARAMETER_GAMMA, 1.5}};

/* ---- frames -------------------------------------------------------------------------------- */

/* The frame of a whole reply, and what it is for: a table or a surface. The test frees it. */
typedef struct made_table {
  bool is_surface;
  core_profile profile;
  core_model_errors errors;
  core_varying varying;
  uint8_t *bytes, *payload;
  size_t count;
} made_table;

/* Returns the model errors that a daemon states. */
static core_model_errors measured(const core_profile *profile) {
  const core_parameters none = core_parameters_none();
  const core_medium *medium = &profile->medium;
  if (!core_ruler_is_needed(profile->model, &none, medium, false)) {
    return core_model_errors_measure(profile, NULL);
  }
  core_profile ruler = unit_profile(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64, medium, &none);
  const core_model_errors errors = core_model_errors_measure(profile, &ruler);
  core_profile_free(&ruler);
  return errors;
}

static void make_frame(made_table *of, const core_parameters *parameters) {
  const size_t payload_bytes = table_reply_bytes(
      parameters, of->is_surface ? table_surface_words(&of->varying) : of->profile.lut_count);
  const wire_header header = {.magic = WIRE_MAGIC,
                              .version = WIRE_VERSION,
                              .type = WIRE_TYPE_TABLE | WIRE_REPLY,
                              .request_id = 9,
                              .payload_bytes = (uint32_t)payload_bytes};
  of->count = WIRE_BYTES_header + payload_bytes;
  of->bytes = malloc(of->count);
  assert_non_null(of->bytes);
  of->payload = of->bytes + WIRE_BYTES_header;
  wire_put_header(of->bytes, &header);
  if (of->is_surface) {
    table_reply_put_surface(of->payload, &of->varying, parameters);
  } else {
    table_reply_put(of->payload, &of->profile, &of->profile.medium, parameters, &of->errors);
  }
}

static made_table make(const char *model, core_medium medium) {
  const core_parameters none = core_parameters_none();
  made_table table = {.is_surface = false};
  table.profile =
      unit_profile(core_choice_by_name(core_models, model)->id, CORE_EVALUATOR_LUT, &medium, &none);
  table.errors = measured(&table.profile);
  make_frame(&table, &none);
  return table;
}

static made_table make_surface(void) {
  core_parameters parameters = core_parameters_none();
  made_table surface = {.is_surface = true};
  for (size_t i = 0; i < 2; i++) {
    parameters.value[given[i].id] = given[i].value;
  }
  unit_accept(core_varying_prepare(&surface.varying, core_isa_select(NULL), CORE_MODEL_TRANSPORT,
                                   CORE_MOMENTS_EXACT, CORE_EVALUATOR_F32, 0.8, 1.4, &parameters));
  make_frame(&surface, &parameters);
  return surface;
}

static void unmake(made_table *of) {
  core_profile_free(&of->profile);
  core_varying_free(&of->varying);
  free(of->bytes);
}

static dipole_table *load(const made_table *of) {
  dipole_table *table;
  dipole_error error;
  peer_expect(dipole_table_load(of->bytes, of->count, &table, &error), &error);
  return table;
}

static dipole_surface *load_surface(const made_table *of) {
  dipole_surface *surface;
  dipole_error error;
  peer_expect(dipole_surface_load(of->bytes, of->count, &surface, &error), &error);
  return surface;
}

/* ---- errors -------------------------------------------------------------------------------- */

enum { HELD = DIPOLE_R | DIPOLE_ALBEDO | DIPOLE_CDF | DIPOLE_PDF | DIPOLE_RING | DIPOLE_S };

/* Returns whether two numbers are equal or are both NaN. */
static bool same(double a, double b) {
  return a == b || (isnan(a) && isnan(b));
}

/* Checks that a table states the errors of its profile. Returns how many model errors are known. */
static size_t assert_same_errors(const dipole_table *table, const made_table *made,
                                 uint64_t *random) {
  const core_profile *profile = &made->profile;
  static const float mfp[] = {0.01f, 0.02f, 0.05f, 1, 2, 20}; /* ends of bands of radii */
  const double mfp_mm = 1 / (profile->medium.sigma_a_per_mm +
                             profile->medium.sigma_s_per_mm * (1 - profile->medium.g));
  size_t known = 0;
  for (int i = 0; i < 400; i++) {
    float r[3] = {0, 0, (float)INFINITY};
    for (size_t k = 0; k < 2; k++) {
      r[k] = (float)(mfp_mm * (i % 4 == 0   ? (double)mfp[unit_random_below(random, 6)]
                               : i % 4 == 1 ? unit_random_log(random, 1e-3, 1e4)
                                            : unit_random_log(random, 0.01, 20)));
    }
    const size_t n = i % 16 == 0 ? 0 : 1 + unit_random_below(random, 3);
    const unsigned wanted = (unsigned)unit_random(random) & HELD;
    core_radii_range range;
    assert_null(core_radii_check_f32(n, r, &range).field);
    const core_stated_errors stated = core_profile_errors(profile, wanted, range);
    dipole_errors errors;
    assert_true(dipole_table_errors(table, wanted, n, r, &errors));
    assert_true(same(errors.numerical_error, stated.numerical));
    assert_true(same(errors.numerical_error_per_mm, stated.numerical_per_mm));
    const double model = core_model_errors_of(&made->errors, &profile->medium, wanted, range);
    assert_true(same(errors.model_error, model));
    known += !isnan(model);
  }
  return known;
}

UNIT_TEST(tables_state_the_errors_of_their_profiles) {
  static const struct {
    const char *model;
    core_medium medium;
    bool known;
  } cases[] = {{"better", {0.032, 0.74, 0, 1.3}, true}, {"classical", {0.1, 5, 0.7, 1.4}, true},
               {"skin-red", {1, 1, 0, 1.3}, true},      {"transport", {0.35, 0.65, 0, 1.5}, true},
               {"transport", {1, 9, 0.5, 1.5}, true},   {"better", {0.1, 1, 0, 2.5}, false}};
  uint64_t random = unit_seed();
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    made_table made = make(cases[i].model, cases[i].medium);
    dipole_table *table = load(&made);
    const size_t known = assert_same_errors(table, &made, &random);
    assert_true(cases[i].known ? known > 20 : known == 0);
    dipole_table_free(table);
    unmake(&made);
  }
}

/* ---- facts, files -------------------------------------------------------------------------- */

UNIT_TEST(what_a_table_does_not_hold_is_refused) {
  static const float bad[] = {-1, (float)NAN, -0x1p-149f};
  static const float bad_shares[] = {-0x1p-149f, (float)NAN, 0x1.000002p0f};
  static const unsigned others[] = {0,           DIPOLE_ALBEDO,         DIPOLE_RADIUS, DIPOLE_SLOPE,
                                    DIPOLE_LN_R, DIPOLE_R | DIPOLE_CDF, 1u << 15};
  made_table made = make("better", skin);
  dipole_table *table = load(&made);
  float in[2] = {1, 1}, out[2] = {77, 77};
  for (size_t i = 0; i < sizeof others / sizeof others[0]; i++) {
    assert_false(dipole_table_values(table, (enum dipole_quantity)others[i], 2, in, out));
  }
  for (size_t i = 0; i < 3; i++) {
    in[1] = bad[i];
    assert_false(dipole_table_values(table, DIPOLE_R, 2, in, out));
    in[1] = bad_shares[i];
    assert_false(dipole_table_radii(table, 2, in, out));
  }
  assert_true(out[0] == 77 && out[1] == 77);
  assert_true(dipole_table_values(table, DIPOLE_R, 0, in, out));
  assert_true(dipole_table_radii(table, 0, in, out));
  dipole_errors errors = {77, 77, 77};
  for (size_t i = 1; i < sizeof others / sizeof others[0]; i++) {
    assert_true(dipole_table_errors(table, others[i], 0, NULL, &errors) ==
                (others[i] == DIPOLE_ALBEDO || others[i] == (DIPOLE_R | DIPOLE_CDF)));
  }
  errors.model_error = 77;
  for (size_t i = 0; i < 3; i++) {
    in[1] = bad[i];
    assert_false(dipole_table_errors(table, DIPOLE_R, 2, in, &errors));
  }
  assert_true(errors.model_error == 77);
  dipole_table_free(table);
  unmake(&made);
}

/* ---- damage -------------------------------------------------------------------------------- */

static void assert_damaged(const made_table *of, const char *why) {
  dipole_table *table = NULL;
  dipole_surface *surface = NULL;
  dipole_error error = {0};
  assert_false(of->is_surface ? dipole_surface_load(of->bytes, of->count, &surface, &error)
                              : dipole_table_load(of->bytes, of->count, &table, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_TABLE);
  assert_non_null(strstr(error.text, why));
  assert_true(table == NULL && surface == NULL);
}

/* Checks that other facts in the fixed part and other media are refused. */
static void assert_facts_are_checked(const made_table *of, size_t count, const core_medium *media) {
  static const char *const headers[] = {"does not start as one", "does not start as one",
                                        "does not start as one", "its end is missing"};
  wire_table_reply right, wrong;
  static const char counts[] = "its counts or its checksum are wrong";
  wire_header header;
  core_medium kept;
  wire_get_table_reply(of->payload, &right);
#define WITH(field, value, why)                                                                    \
  do {                                                                                             \
    wrong = right;                                                                                 \
    wrong.field = (value);                                                                         \
    wire_put_table_reply(of->payload, &wrong);                                                     \
    assert_damaged(of, why);                                                                       \
  } while (0)
  WITH(layout, 1, "this table has layout 1, but this library reads layout");
  WITH(word_count, right.word_count - 4, counts);
  WITH(word_count, 0, counts);
  WITH(word_count, UINT32_MAX, counts);
  WITH(parameter_count, right.parameter_count + 1, counts);
  WITH(parameter_count, 65535, counts);
  WITH(checksum, right.checksum + 1, counts);
  WITH(layer_count, 0, counts);
  WITH(layer_count, 2, counts);
  WITH(layer_count, UINT32_MAX, counts);
  if (of->is_surface) {
    WITH(model, 0, "its words are not those of its model");
    WITH(model, CORE_MODEL_GAUSSIANS, "its words are not those of its model");
    WITH(moments, 9, "its words are not those of its model");
  } else {
    WITH(reach, (double)NAN, "up to which radius");
    WITH(reach, 0, "up to which radius");
    WITH(reach_growth, -1, "up to which radius");
    WITH(reach_growth, (double)NAN, "up to which radius");
    WITH(pieces_from, 2 * right.pieces_from, "the radii of its pieces");
    WITH(pieces_to, (double)NAN, "the radii of its pieces");
  }
#undef WITH
  wire_put_table_reply(of->payload, &right);
  uint8_t *layer = of->payload + WIRE_BYTES_table_reply;
  memcpy(&kept, layer, sizeof kept);
  for (size_t i = 0; i < count; i++) {
    memcpy(layer, &media[i], sizeof media[i]);
    assert_damaged(of, !of->is_surface                ? "its medium or a parameter is not valid"
                       : media[i].sigma_a_per_mm != 0 ? "it is the table of one medium"
                                                      : "this is not an intact surface");
  }
  memcpy(layer, &kept, sizeof kept);
  wire_get_header(of->bytes, &header);
  for (int i = 0; i < 4; i++) {
    wire_header other = header;
    other.magic += i == 0;
    other.version += i == 1;
    other.type = (uint16_t)(other.type + (i == 2));
    other.payload_bytes += i == 3 ? 8 : 0;
    wire_put_header(of->bytes, &other);
    assert_damaged(of, headers[i]);
  }
  wire_put_header(of->bytes, &header);
}

UNIT_TEST(impossible_facts_are_found) {
  static const core_medium media[] = {{0.032, 0.74, 0, (double)NAN},
                                      {0.032, 0.74, 1, 1.3},
                                      {0.032, -1, 0, 1.3},
                                      {1, 1, 0, 1.3, -1}};
  static const core_medium of_surfaces[] = {{1, 0, 0.8, 1.4}, {0, (double)NAN, 0.8, 1.4},
                                            {0, 0, 1, 1.4},   {0, 0, (double)NAN, 1.4},
                                            {0, 0, 0.8, 0},   {0, 0, 0.8, (double)NAN}};
  made_table table = make("better", skin), surface = make_surface();
  assert_facts_are_checked(&table, sizeof media / sizeof media[0], media);
  assert_facts_are_checked(&surface, sizeof of_surfaces / sizeof of_surfaces[0], of_surfaces);
  dipole_table_free(load(&table));
  dipole_surface_free(load_surface(&surface));
  unmake(&table);
  unmake(&surface);
}

/* ---- fetching ------------------------------------------------------------------------------ */

/* A script answers table requests with the payload, and echoes pings. */
static void answer_requests(int fd, void *context) {
  const made_table *with = context;
  peer_frame request;
  bool good = peer_say_hello(fd);
  while (good && peer_receive(fd, &request)) {
    schema_layout layout;
    const bool ping = request.header.type == WIRE_TYPE_PING;
    if (!ping &&
        schema_check(&schema_table_request, request.payload, request.header.payload_bytes, &layout)
                .status != WIRE_STATUS_OK) {
      abort(); /* The library makes only well-formed requests. */
    }
    good = peer_send(fd, (uint16_t)(request.header.type | WIRE_REPLY), request.header.request_id,
                     ping ? request.payload : with->payload,
                     ping ? request.header.payload_bytes : with->count - WIRE_BYTES_header);
    free(request.payload);
  }
}

/* Checks that a fetch from a peer that answers so fails with this kind of error, and that the client
 * is used no more if the answer was wrong. */
static void assert_not_fetched(const made_table *with, const dipole_table_query *query,
                               enum dipole_error_kind kind) {
  made_table context = *with;
  dipole_table *table = NULL;
  dipole_surface *surface = NULL;
  dipole_error error = {0};
  dipole_client *client = peer_begin(answer_requests, &context);
  assert_false(with->is_surface ? dipole_surface_fetch(client, query, &surface, &error)
                                : dipole_table_fetch(client, query, &table, &error));
  assert_int_equal(error.kind, kind);
  assert_true(table == NULL && surface == NULL);
  assert_int_equal(dipole_ping(client, NULL), kind == DIPOLE_ERROR_ARGUMENT);
  peer_finish(client);
}

UNIT_TEST(other_answers_are_refused) {
  made_table table = make("better", skin), surface = make_surface();
  const dipole_table_query of_table = {
      .model = CORE_MODEL_BETTER, .moments = DIPOLE_EXACT, .medium = {0.032, 0.74, 0, 1.3}};
  const dipole_table_query of_surface = {.model = CORE_MODEL_TRANSPORT,
                                         .moments = DIPOLE_EXACT,
                                         .medium = {0, 0, 0.8, 1.4},
                                         .parameters = given,
                                         .parameter_count = 2};
  const dipole_parameter looser = {CORE_PARAMETER_TOLERANCE, 0.02};
  for (int k = 0; k < 2; k++) {
    const dipole_table_query right = k == 0 ? of_table : of_surface;
    dipole_table_query others[6] = {right, right, right, right, right, right};
    others[0].model = CORE_MODEL_CLASSICAL;
    others[1].moments = DIPOLE_FIT;
    others[2].medium.g = 0.5;
    others[3].medium.eta = 1.35;
    others[4].parameter_count = k == 0;
    others[4].parameters = given;
    others[5].parameters = &looser;
    others[5].parameter_count = 1;
    for (size_t i = 0; i < 6; i++) {
      assert_not_fetched(k == 0 ? &table : &surface, &others[i], DIPOLE_ERROR_PROTOCOL);
    }
    others[0] = right;
    others[0].medium.sigma_s_per_mm += 1;
    assert_not_fetched(k == 0 ? &table : &surface, &others[0],
                       k == 0 ? DIPOLE_ERROR_PROTOCOL : DIPOLE_ERROR_ARGUMENT);
  }
  static const size_t counts[] = {0, 8};
  made_table shorter = table;
  for (size_t i = 0; i < 3; i++) {
    shorter.count = i < 2 ? WIRE_BYTES_header + counts[i] : table.count - 8;
    assert_not_fetched(&shorter, &of_table, DIPOLE_ERROR_PROTOCOL);
  }
  table.bytes[table.count - 1] ^= 1;
  assert_not_fetched(&table, &of_table, DIPOLE_ERROR_PROTOCOL);
  unmake(&table);
  unmake(&surface);
}

/* ---- queries that are wrong ---------------------------------------------------------------- */

static void assert_refused(const dipole_surface *surface, const dipole_varying_query *query,
                           const char *why) {
  dipole_varying_result *result = NULL;
  dipole_error error = {0};
  assert_false(dipole_varying_at_home(surface, query, &result, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_ARGUMENT);
  assert_ptr_equal(strstr(error.text, why), error.text);
  assert_null(result);
}

UNIT_TEST(queries_of_other_media_are_refused) {
  const dipole_parameter finer[] = {{CORE_PARAMETER_TOLERANCE, 1e-3}, given[1]};
  const dipole_parameter other[] = {given[0], {CORE_PARAMETER_GAMMA, 1}};
  static const float numbers[] = {0.5F, 1};
  made_table of = make_surface();
  dipole_surface *surface = load_surface(&of);
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
                                      .parameters = given,
                                      .parameter_count = 2};
  dipole_varying_result *result;
  assert_true(dipole_varying_at_home(surface, &right, &result, NULL));
  assert_int_equal(result->notes, CORE_NOTE_GAMMA);
  dipole_varying_result_free(result);
#define OTHER "the surface is not that of this query's model, moments, g, eta and parameters"
#define WITH(field, value, why)                                                                    \
  do {                                                                                             \
    dipole_varying_query wrong = right;                                                            \
    wrong.field = (value);                                                                         \
    assert_refused(surface, &wrong, why);                                                          \
  } while (0)
  WITH(model, CORE_MODEL_BETTER, OTHER);
  WITH(model, 0, "model is 0, which");
  WITH(moments, DIPOLE_FIT, OTHER);
  WITH(g, 0, OTHER);
  WITH(g, (double)NAN, OTHER);
  WITH(eta, 1.3, OTHER);
  WITH(parameters, finer, OTHER);
  WITH(parameters, other, OTHER);
  WITH(parameter_count, 0, OTHER);
  WITH(parameter_count, 1, OTHER);
  WITH(evaluator, DIPOLE_LUT, "evaluator: allowed: f64 or f32");
  WITH(wanted, DIPOLE_RADIUS,
       "wanted: allowed: R, albedo, cdf, pdf, 2_pi_r_R, model_error of radii; with u r too; else "
       "albedo");
  WITH(wanted, 1u << 14,
       "wanted: allowed: R, albedo, cdf, pdf, 2_pi_r_R, model_error of radii; with u r too; else "
       "albedo");
  WITH(coefficients, 8, "coefficients: allowed: a sum of 1 (sigma_a), 2 (sigma_s), 4 (scattered)");
  WITH(sigma_a_per_mm, NULL, "sigma_a is NULL although its count is not 0");
  WITH(colours, right.sigma_a_per_mm, "given has to be set with colours, and 0 without them");
  WITH(given, DIPOLE_MEAN_FREE_PATH, "given has to be set with colours, and 0 without them");
  WITH(light, DIPOLE_BEAM, "light: allowed: 0 where");
  WITH(specular, true, "specular: allowed: 0 where");
  WITH(radii, NULL,
       "wanted: allowed: R, albedo, cdf, pdf, 2_pi_r_R, model_error of radii; with u r too; else "
       "albedo");
  WITH(numbers, right.radii, "u has 2 elements, where the other fields want 0");
  WITH(value_count, UINT64_MAX, "this is more than a frame holds: request less at a time");
#undef WITH
  dipole_surface_free(surface);
  unmake(&of);
}

/* ---- without a daemon ---------------------------------------------------------------------- */

UNIT_TEST(the_library_knows_its_lists) {
  dipole_info *info;
  size_t models = 0;
  assert_true(dipole_local_info(&info, NULL));
  for (size_t i = 0; i < info->choice_count; i++) {
    const dipole_choice *choice = &info->choices[i];
    assert_true(choice->name[0] != '\0' && choice->about[0] != '\0');
    if (choice->kind == DIPOLE_MODEL) {
      assert_string_equal(choice->name, core_choice_by_id(core_models, choice->id)->name);
      models++;
    }
  }
  assert_true(models > 2);
  assert_string_equal(info->instruction_set, core_isa_name(core_isa_select(NULL)));
  assert_int_equal(info->limit_count, 0);
  free(info);
}
