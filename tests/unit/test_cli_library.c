/* libdipole against a peer that follows a script: orders and sizes of answers, and wrong answers,
 * that a real daemon does not produce on demand. */
#include <math.h>

#include "core/montecarlo/montecarlo.h"
#include "tests/unit/peer_scripts.h"
#include "tests/unit/unit.h"

static const double radii[3] = {0.5, 1, 2};

static const dipole_query simple_query = {.model = 2,
                                          .evaluator = DIPOLE_F64,
                                          .moments = DIPOLE_EXACT,
                                          .wanted = DIPOLE_R | DIPOLE_ALBEDO | DIPOLE_CDF,
                                          .media = peer_media,
                                          .medium_count = 2,
                                          .spacing = DIPOLE_LIST,
                                          .radii = radii,
                                          .radius_count = 3};

/* ---- honest answers ------------------------------------------------------------------------ */

static void check_simple_result(dipole_result *result) {
  assert_int_equal(result->channel_count, 2);
  assert_int_equal(result->radius_count, 3);
  assert_null(result->radius_f64);
  for (size_t i = 0; i < 2; i++) {
    const dipole_channel *channel = &result->channels[i];
    assert_true(channel->albedo == peer_media[i].sigma_a_per_mm);
    assert_null(channel->R_f32);
    assert_null(channel->cdf_f32);
    assert_int_equal((uintptr_t)channel->R_f64 % 8, 0);
    assert_int_equal((uintptr_t)channel->cdf_f64 % 8, 0);
    for (size_t k = 0; k < 3; k++) {
      assert_true(channel->R_f64[k] == 2 * radii[k]);
      assert_true(channel->cdf_f64[k] == radii[k] / 4);
    }
  }
  dipole_result_free(result);
}

UNIT_TEST(test_eval) {
  dipole_client *client = peer_begin(peer_serve, NULL);
  const dipole_info *info = dipole_get_info(client);
  assert_string_equal(info->address, peer_of_test.address);
  /* Control characters were replaced. */
  assert_string_equal(info->software, "scripted?[31m");
  assert_string_equal(info->instruction_set, "avx?2");
  assert_string_equal(info->R_unit, "1/mm^2?");
  assert_string_equal(info->choices[0].about, "half?spaces");
  assert_int_equal(dipole_id(client, DIPOLE_MODEL, "better"), 2);
  assert_int_equal(dipole_id(client, DIPOLE_MODEL, "bad-value"), 0);
  check_simple_result(peer_eval(client, &simple_query));
  peer_finish(client);
}

/* The request lists parameters and then five floats, which need padding. */
UNIT_TEST(test_parameters_and_notes) {
  static const float r[5] = {1, 2, 3, 4, 5};
  static const dipole_parameter parameters[2] = {{CORE_PARAMETER_COS_OUT, 0.25},
                                                 {CORE_PARAMETER_COS_IN, 0.75}};
  dipole_error error;
  dipole_result *result;
  dipole_query query = simple_query;
  query.evaluator = DIPOLE_F32;
  query.wanted = DIPOLE_S | DIPOLE_MODEL_ERROR;
  query.radii = r;
  query.radius_count = 5;
  query.parameters = parameters;
  query.parameter_count = 2;
  dipole_client *client = peer_begin(peer_serve, NULL);
  assert_true(dipole_eval(client, &query, &result, &error));
  assert_int_equal(result->notes, 2);
  for (uint32_t i = 0; i < 2; i++) {
    assert_true(result->channels[i].model_error == 0.75);
    assert_null(dipole_values_f32(result, i, DIPOLE_RING));
    assert_null(dipole_values_f64(result, i, DIPOLE_S));
    assert_true(dipole_values_f32(result, i, DIPOLE_S)[4] == 15);
  }
  dipole_result_free(result);
  assert_true(dipole_eval(client, &simple_query, &result, &error)); /* without parameters */
  assert_int_equal(result->notes, 0);
  assert_true(isnan(result->channels[0].model_error));
  dipole_result_free(result);
  peer_finish(client);
}

/* ---- refusals ------------------------------------------------------------------------------ */

static const char *const refused_fields[] = {"sigma_a", "r", "model", "", "max_mc_jobs"};

enum { REFUSALS = sizeof refused_fields / sizeof refused_fields[0] };

/* A script that refuses some requests and answers the one after them. */
static void refuse(int fd, void *context) {
  (void)context;
  peer_say_hello(fd);
  for (size_t i = 0; i < REFUSALS + 1; i++) {
    peer_frame request;
    uint8_t bytes[WIRE_BYTES_error];
    peer_receive_or_abort(fd, &request);
    if (i < REFUSALS) {
      wire_error error = {.status = WIRE_STATUS_BAD_VALUE, .index = 1};
      WIRE_SET_TEXT(error.field, refused_fields[i]);
      WIRE_SET_TEXT(error.allowed, "0 to 1e15");
      if (i >= 3) {
        error.status = WIRE_STATUS_BUSY;
        error.retry_after_ms = 7;
      }
      wire_put_error(bytes, &error);
      peer_send(fd, WIRE_TYPE_ERROR, request.header.request_id, bytes, sizeof bytes);
    } else {
      peer_answer(fd, &request);
    }
    free(request.payload);
  }
}

UNIT_TEST(test_refusals_say_what_is_allowed) {
  static const char *const texts[REFUSALS] = {
      "bad-value: sigma_a of medium 2 of 2: allowed: 0 to 1e15",
      "bad-value: r number 2 of 3: allowed: 0 to 1e15", "bad-value: model: allowed: 0 to 1e15",
      "busy: the daemon is at its limit; try again later (in 7 ms)",
      "busy: the daemon is at its limit; try again later (in 7 ms): max_mc_jobs: allowed: 0 to "
      "1e15"};
  dipole_error error;
  dipole_result *result;
  dipole_client *client = peer_begin(refuse, NULL);
  for (size_t i = 0; i < REFUSALS; i++) {
    assert_false(dipole_eval(client, &simple_query, &result, &error));
    assert_int_equal(error.kind, DIPOLE_ERROR_REFUSED);
    assert_string_equal(error.text, texts[i]);
    assert_string_equal(error.field, refused_fields[i]);
    assert_int_equal(error.status, i < 3 ? WIRE_STATUS_BAD_VALUE : WIRE_STATUS_BUSY);
    assert_int_equal(error.retry_after_ms, i < 3 ? 0 : 7);
  }
  check_simple_result(peer_eval(client, &simple_query));
  peer_finish(client);
}

UNIT_TEST(test_busy_at_connecting) {
  dipole_client *client;
  dipole_error error;
  peer_start(&peer_of_test, peer_be_full, NULL);
  dipole_options options = peer_options();
  options.retry_ms = 0;
  assert_false(dipole_open_with(peer_of_test.address, &options, &client, &error));
  assert_null(client);
  assert_int_equal(error.kind, DIPOLE_ERROR_REFUSED);
  assert_int_equal(error.status, WIRE_STATUS_BUSY);
  assert_int_equal(error.retry_after_ms, 30);
  peer_end(&peer_of_test);
}

/* ---- lies ---------------------------------------------------------------------------------- */

/* A change of one number in the header of an otherwise correct answer; test_messages.py changes
 * payloads. */
typedef struct one_lie {
  const char *what;
  size_t offset; /* of the number, from the start of the frame */
  size_t bytes;
  uint64_t value;
} one_lie;

static void tell_lie(int fd, void *context) {
  const one_lie *lie = context;
  peer_frame request;
  size_t bytes;
  peer_say_hello_or_abort(fd);
  peer_receive_or_abort(fd, &request);
  uint8_t *frame = peer_make_answer(&request, SIZE_MAX, &bytes);
  for (size_t i = 0; i < lie->bytes; i++) {
    frame[lie->offset + i] = (uint8_t)(lie->value >> (8 * i));
  }
  peer_send_bytes(fd, frame, bytes);
  free(frame);
  free(request.payload);
}

UNIT_TEST(test_lies_are_noticed) {
  one_lie lies[] = {
      {"magic", 0, 4, 0x12345678},
      {"version", 4, 2, 1},
      {"another type", 6, 2, WIRE_TYPE_PING | WIRE_REPLY},
      {"a request instead of an answer", 6, 2, WIRE_TYPE_EVAL},
      {"an error of another length", 6, 2, WIRE_TYPE_ERROR},
      {"an answer that nobody asked for", 8, 8, 12345},
      {"a payload of 4 GiB", 16, 4, 0xfffffff8},
      {"an empty payload", 16, 4, 0},
      {"a payload that is not padded", 16, 4, 3},
  };
  for (size_t i = 0; i < sizeof lies / sizeof lies[0]; i++) {
    dipole_error error;
    dipole_result *result;
    dipole_client *client = peer_begin(tell_lie, &lies[i]);
    for (int again = 0; again < 2; again++) { /* The client stays broken after the first error. */
      UNIT_FAIL_IF(dipole_eval(client, &simple_query, &result, &error), "not noticed: %s",
                   lies[i].what);
      if (error.kind != DIPOLE_ERROR_PROTOCOL) {
        fail_msg("%s: %s", lies[i].what, error.text);
      }
    }
    peer_finish(client);
  }
}

/* ---- arguments ----------------------------------------------------------------------------- */

/* A query of which one field is another is not sent, and the error says why. call: has it as
 * `wrong`. */
#define REFUSED(right, call, field, value, why)                                                    \
  do {                                                                                             \
    __typeof__(right) wrong = (right);                                                             \
    wrong.field = (value);                                                                         \
    error = (dipole_error){0};                                                                     \
    if ((call) || error.kind != DIPOLE_ERROR_ARGUMENT || strcmp(error.text, why) != 0) {           \
      fail_msg("%s = %s: %s", #field, #value, error.text);                                         \
    }                                                                                              \
  } while (false)

#define NO_MODEL                                                                                   \
  "model is 0, which is what dipole_id() returns for a name that the daemon does not have"
#define IDS "model, moments and other ids are at most 65535"
#define NO_PARAMETERS "parameters is NULL although parameter_count is not 0"
#define NO_MEDIA "media is NULL although medium_count is not 0"
#define NOT_ALL "into_values and into_radii are needed for all that is wanted, or for none of it"
#define NO_LIST "radii or numbers is NULL although their count is not 0"

UNIT_TEST(test_arguments) {
  dipole_error error;
  dipole_query plain = simple_query;
  dipole_result *result;
  dipole_client *client = peer_begin(peer_serve, NULL);
  static const dipole_parameter beyond = {65536 + CORE_PARAMETER_COS_IN, 0.5};
  const dipole_parameter misspelt = {dipole_id(client, DIPOLE_PARAMETER, "tolerence"), 0.01};
#define EVAL(of, field, value, why)                                                                \
  REFUSED(of, dipole_eval(client, &wrong, &result, &error), field, value, why)
  EVAL(plain, media, NULL, NO_MEDIA);
  EVAL(plain, radii, NULL, NO_LIST);
  EVAL(plain, evaluator, 99,
       "evaluator is 99: this library knows DIPOLE_F64, DIPOLE_F32 and DIPOLE_LUT");
  EVAL(plain, radius_count, 1 << 29,
       "the request takes 4294967424 bytes, more than a frame holds: request fewer radii "
       "or "
       "media at a time");
  EVAL(plain, model, 0, NO_MODEL);
  EVAL(plain, model, 65536 + 2, IDS);
  EVAL(plain, spacing, 65536 + DIPOLE_LIST, IDS);
  EVAL(plain, parameter_count, 1, NO_PARAMETERS);
  EVAL(plain, into_radii, &result, NOT_ALL);
  plain.wanted |= DIPOLE_RADIUS;
  EVAL(plain, into_values, &result, NOT_ALL);
  plain = simple_query;
  EVAL(plain, model, DIPOLE_ANY_MODEL, "DIPOLE_ANY_MODEL needs the parameter tolerance");
  plain.parameters = &beyond;
  EVAL(plain, parameter_count, 1, "the id of a parameter is at most 65535");
  EVAL(plain, parameter_count, 65536 + 1, "parameter_count is at most 65535");
  plain.parameters = &misspelt;
  EVAL(plain, parameter_count, 1,
       "the id of parameters[0] is 0, which is what dipole_id() returns for a name that the daemon "
       "does "
       "not have");

  dipole_table *table;
  dipole_table_query fetched = {.model = 2, .moments = DIPOLE_EXACT, .medium = peer_media[0]};
#define TABLE(field, value, why)                                                                   \
  REFUSED(fetched, dipole_table_fetch(client, &wrong, &table, &error), field, value, why)
  TABLE(model, 0, NO_MODEL);
  TABLE(moments, 65536, "moments is a whole number from 0 to 65535");
  TABLE(parameter_count, 1, "parameter is NULL although its count is not 0");
  TABLE(medium, (dipole_medium){0},
        "sigma_a and sigma_s are 0: dipole_surface_fetch() is for all media");
  dipole_surface *surface;
  REFUSED(fetched, dipole_surface_fetch(client, &wrong, &surface, &error), layer_count, 1,
          "sigma_a and sigma_s of a surface's query are 0: it is for all media");

  dipole_mc_result *walked;
  dipole_mc_query job = {.medium = peer_media[0],
                         .spacing = DIPOLE_LINEAR,
                         .ring_count = 2,
                         .radius_stop_mm = 2,
                         .photons = 1000};
#define MC(field, value, why)                                                                      \
  REFUSED(job, dipole_mc(client, &wrong, NULL, NULL, &walked, &error), field, value, why)
  MC(albedo_count, 1, "albedos is NULL although albedo_count is not 0");
  MC(albedo_count, CORE_MC_ALBEDOS_MAX + 1, "albedo_count is at most 16");
  MC(spacing, 65536, IDS);

  dipole_sample_query drawn = {.model = 2,
                               .evaluator = DIPOLE_F64,
                               .moments = DIPOLE_EXACT,
                               .wanted = DIPOLE_RADIUS,
                               .media = peer_media,
                               .medium_count = 1,
                               .draw = DIPOLE_DRAW_RANDOM,
                               .seed = 1,
                               .sample_count = 3};
#define SAMPLE(field, value, why)                                                                  \
  REFUSED(drawn, dipole_sample(client, &wrong, &result, &error), field, value, why)
#define NUMBERS(begin, n, field, value, why)                                                       \
  REFUSED(drawn, dipole_sample_numbers(&wrong, begin, n, numbers, &error), field, value, why)
  double numbers[3];
  SAMPLE(media, NULL, NO_MEDIA);
  SAMPLE(model, 65536, IDS);
  SAMPLE(evaluator, 9, "evaluator is 9: this library knows DIPOLE_F64, DIPOLE_F32 and DIPOLE_LUT");
  SAMPLE(draw, DIPOLE_DRAW_LIST, NO_LIST);
  NUMBERS(0, 3, draw, 9,
          "draw is 9: numbers are made for DIPOLE_DRAW_REGULAR, DIPOLE_DRAW_STRATIFIED and "
          "DIPOLE_DRAW_RANDOM");
  NUMBERS(0, 3, sample_first, UINT64_MAX, "sample_first: allowed: 0 to 2^52");
  NUMBERS(0, 3, evaluator, 9, "evaluator is 9");
  NUMBERS(0, 3, draw, DIPOLE_DRAW_REGULAR,
          "seed: allowed: 0 unless the draw is random or stratified");
  NUMBERS(3, 1, seed, 2, "there are only 3 numbers");
  NUMBERS(4, 0, seed, 2, "there are only 3 numbers");
  NUMBERS(1, SIZE_MAX, seed, 2, "there are only 3 numbers");
  assert_true(dipole_sample_numbers(&drawn, 3, 0, numbers, &error));
  double last;
  assert_true(dipole_sample_numbers(&drawn, 0, 3, numbers, &error));
  assert_true(dipole_sample_numbers(&drawn, 2, 1, &last, &error) && last == numbers[2]);

  dipole_inversion *inversion;
  dipole_invert_query inverted = {.model = 2,
                                  .moments = DIPOLE_EXACT,
                                  .given = 1,
                                  .eta = 1.4,
                                  .albedos = radii,
                                  .lengths_mm = radii,
                                  .medium_count = 1};
#define INVERT(field, value, why)                                                                  \
  REFUSED(inverted, dipole_invert(client, &wrong, &inversion, &error), field, value, why)
  INVERT(albedos, NULL, "albedo is NULL although its count is not 0");
  INVERT(lengths_mm, NULL, "length is NULL although its count is not 0");
  INVERT(given, 65536, "given is a whole number from 0 to 65535");
  INVERT(medium_count, UINT32_MAX + 1ull,
         "this is more than a frame holds: request less at a time");

  dipole_points *points;
  float power_W = 1;
  struct {
    uint64_t count;
    uint32_t channels;
    const double *xyz_mm;
    const float *power_W;
  } cloud = {1, 1, radii, &power_W};
#define POINTS(field, value, why)                                                                  \
  REFUSED(cloud,                                                                                   \
          dipole_points_make(wrong.count, wrong.channels, wrong.xyz_mm, wrong.power_W, &points,    \
                             &error),                                                              \
          field, value, why)
  POINTS(count, 0, "point_count is not from 1 to 16777216");
  POINTS(count, 16777217, "point_count is not from 1 to 16777216");
  POINTS(channels, 0, "channel_count is not from 1 to 8");
  POINTS(channels, 9, "channel_count is not from 1 to 8");
  POINTS(xyz_mm, NULL, "xyz_mm or power_W is NULL");
  POINTS(power_W, NULL, "xyz_mm or power_W is NULL");
  assert_null(points);
  double *most = calloc(3 * 16777216, sizeof *most); /* of zeros that take no memory */
  assert_true(dipole_points_make(16777216, 1, most, (float *)most, &points, &error));
  dipole_points_free(points);
  free(most);
  assert_true(dipole_points_make(1, 1, radii, &power_W, &points, &error));
  dipole_gather_query gathered = {.model = 2,
                                  .evaluator = DIPOLE_F64,
                                  .moments = DIPOLE_EXACT,
                                  .points = points,
                                  .media = peer_media,
                                  .queries_mm = radii,
                                  .query_count = 1};
#define GATHER(field, value, why)                                                                  \
  REFUSED(gathered, dipole_gather(client, &wrong, NULL, NULL, numbers, NULL, &error), field,       \
          value, why)
  GATHER(points, NULL, "points or media is NULL");
  GATHER(media, NULL, "points or media is NULL");
  GATHER(queries_mm, NULL, "queries_mm is NULL although query_count is not 0");
  GATHER(query_count, UINT64_MAX / 64 + 1, "query_count is more than memory holds");
  GATHER(moments, 65536, IDS);
  dipole_points_free(points);

  dipole_fits *fits;
  dipole_fit_query fitted = {.model = 2,
                             .moments = DIPOLE_EXACT,
                             .axis = 1,
                             .scale = DIPOLE_ABSOLUTE,
                             .reading_count = 3,
                             .at = radii,
                             .set_count = 1,
                             .values = radii,
                             .errors = radii};
#define FIT(field, value, why)                                                                     \
  REFUSED(fitted, dipole_fit(client, &wrong, &fits, &error), field, value, why)
  FIT(axis, 65536, "axis is a whole number from 0 to 65535");
  FIT(at, NULL, "at is NULL although its count is not 0");
  FIT(set_count, UINT64_MAX / 2, "set_count is a whole number from 0 to 9007199254740992");

  dipole_layers_fit *layers_fit;
  dipole_layers_query layered = {.layers = peer_media, .layer_count = 1, .scale = DIPOLE_ABSOLUTE};
#define LAYERS(field, value, why)                                                                  \
  REFUSED(layered, dipole_fit_layers(client, &wrong, &layers_fit, &error), field, value, why)
  LAYERS(unknowns, 65536, "unknowns is a whole number from 0 to 65535");
  LAYERS(scale, 65536, "scale is a whole number from 0 to 65535");
  LAYERS(reading_count, 1, "at is NULL although its count is not 0");

  dipole_medium medium;
  dipole_tissue_query tissue = {
      .haemoglobin = DIPOLE_PRAHL, .wavelengths_nm = radii, .wavelength_count = 3};
#define TISSUE(field, value, why)                                                                  \
  REFUSED(tissue, dipole_tissue(client, &wrong, &medium, &error), field, value, why)
  TISSUE(haemoglobin, 65536, "haemoglobin is a whole number from 0 to 65535");
  TISSUE(wavelengths_nm, NULL, "wavelength is NULL although its count is not 0");

  dipole_tissue_fits *tissue_fits;
  static const dipole_sought sought;
  dipole_tissue_fit_query spectra = {.tissue = tissue,
                                     .model = 2,
                                     .axis = 1,
                                     .scale = DIPOLE_ABSOLUTE,
                                     .sought = &sought,
                                     .sought_count = 1,
                                     .place_count = 1,
                                     .at = radii,
                                     .set_count = 1,
                                     .values = radii,
                                     .errors = radii};
#define SPECTRA(field, value, why)                                                                 \
  REFUSED(spectra, dipole_fit_tissue(client, &wrong, &tissue_fits, &error), field, value, why)
  SPECTRA(sought, NULL, "sought is NULL although its count is not 0");
  SPECTRA(values, NULL, "values is NULL although its count is not 0");
  SPECTRA(axis, 0,
          "axis is 0, which is what dipole_id() returns for a name that the daemon does not have");

  dipole_varying_result *varied;
  dipole_varying_query varying = {.model = 2,
                                  .evaluator = DIPOLE_F64,
                                  .moments = DIPOLE_EXACT,
                                  .sigma_a_per_mm = radii,
                                  .sigma_s_per_mm = radii,
                                  .radii = radii,
                                  .value_count = 3};
#define VARYING(field, value, why)                                                                 \
  REFUSED(varying, dipole_varying(client, &wrong, &varied, &error), field, value, why)
  VARYING(coefficients, 65536, "coefficients is a whole number from 0 to 65535");
  VARYING(colours, radii, "given has to be set with colours, and 0 without them");
  VARYING(sigma_s_per_mm, NULL, "sigma_s is NULL although its count is not 0");
  VARYING(numbers, radii, "u has 3 elements, where the other fields want 0");

  check_simple_result(peer_eval(client, &simple_query)); /* The client sent none of the above. */
  peer_finish(client);
  dipole_close(NULL);
  dipole_result_free(NULL);
  dipole_inversion_free(NULL);
}
