/* The targets for libdipole: `table`, tables from elsewhere, and `replies`, answers of a daemon. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "clients/c/request.h"
#include "core/lut/lut.h"
#include "proto/table.h"
#include "proto/varying.h"
#include "tests/fuzz/fuzz.h"

/* ---- tables from elsewhere ----------------------------------------------------------------------- */

/* The bytes of a table reply up to its words: its medium has one layer, and it has a parameter. */
static size_t bytes_before_words(void) {
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_TOLERANCE] = 1;
  return table_reply_bytes(&parameters, 0);
}

static uint8_t *whole_table; /* a valid table: the frame of a table reply */
static size_t whole_table_bytes;

void fuzz_table_start(void) {
  const core_medium medium = {0.032, 0.74, 0, 1.3};
  core_parameters parameters = core_parameters_none();
  core_profile profile;
  parameters.value[CORE_PARAMETER_TOLERANCE] = CORE_LUT_TOLERANCE_MAX;
  CHECK(core_profile_prepare(&profile, core_isa_select(NULL), CORE_MODEL_BETTER, CORE_MOMENTS_EXACT,
                             CORE_EVALUATOR_LUT, &medium, &parameters)
            .field == NULL);
  const size_t payload_bytes = table_reply_bytes(&parameters, profile.lut_count);
  const wire_header header = {.magic = WIRE_MAGIC,
                              .version = WIRE_VERSION,
                              .type = WIRE_TYPE_TABLE | WIRE_REPLY,
                              .payload_bytes = (uint32_t)payload_bytes};
  whole_table_bytes = WIRE_BYTES_header + payload_bytes;
  whole_table = malloc(whole_table_bytes);
  wire_put_header(whole_table, &header);
  const core_model_errors unknown = core_model_errors_unknown();
  table_reply_put(whole_table + WIRE_BYTES_header, &profile, &medium, &parameters, &unknown);
  core_profile_free(&profile);
}

/* The octaves of positive floats, from OCTAVE_FIRST to OCTAVE_END - 1. The radii are the first and
 * the last float of each octave, and then 0 and infinity. */
enum { OCTAVE_FIRST = -149, OCTAVE_END = 128, RADII = 2 * (OCTAVE_END - OCTAVE_FIRST) + 2 };

static void check_same(const float *a, const float *b) {
  for (int i = 0; i < RADII; i++) {
    CHECK(a[i] == b[i] || (a[i] != a[i] && b[i] != b[i]));
  }
}

/* Evaluates the table at all radii, by the best instruction set and by the portable one, of which
 * the sanitizer sees every read. */
static void check_table(const dipole_table *table, const uint8_t *payload, size_t payload_bytes) {
  float r[RADII], u[RADII], best[RADII], portable[RADII];
  wire_table_reply fixed;
  const core_medium *layers;
  core_parameters parameters;
  const float *words;
  for (int octave = OCTAVE_FIRST, i = 0; octave < OCTAVE_END; octave++, i += 2) {
    r[i] = ldexpf(1, octave);
    r[i + 1] = nextafterf(2 * r[i], 0);
    u[i] = octave < 0 ? r[i] : 1 - ldexpf(1, -octave);
    u[i + 1] = octave < 0 ? r[i + 1] : nextafterf(u[i], 0);
  }
  r[RADII - 2] = u[RADII - 2] = 0;
  r[RADII - 1] = (float)INFINITY;
  u[RADII - 1] = 1;
  CHECK(table_reply_parse(payload, payload_bytes, &fixed, &layers, &parameters, &words));
  core_profile profile = {.medium = *layers,
                          .model = (enum core_model)fixed.model,
                          .albedo = fixed.albedo,
                          .radii = {fixed.radius_least, fixed.radius_most}};
  CHECK(core_profile_from_table(&profile, core_isa_select("portable"), words, fixed.word_count)
            .field == NULL);
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    if (dipole_table_values(table, (enum dipole_quantity)quantity->id, RADII, r, best) &&
        quantity->id != CORE_QUANTITY_S) { /* S depends on the angles. */
      core_eval_f32(&profile, (enum core_quantity)quantity->id, RADII, r, portable);
      check_same(best, portable);
    }
  }
  dipole_errors errors;
  if (dipole_table_errors(table, DIPOLE_R, RADII, r, &errors)) {
    double least = fixed.numerical_error;
    for (size_t i = 0; i < CORE_ERROR_BANDS; i++) {
      least = fixed.numerical_errors[i] < least ? fixed.numerical_errors[i] : least;
    }
    CHECK(!(errors.numerical_error < least));
  }
  CHECK(dipole_table_radii(table, RADII, u, best));
  core_sample_f32(&profile, RADII, u, portable);
  check_same(best, portable);
  core_profile_free(&profile);
}

/* The target for tables. An input is a row of changes to a valid table: the number of a word, two
 * bytes, and its new value, four bytes. A number beyond the words cuts the table short. Afterwards
 * the checksum, and fields that repeat words, are corrected, unless the last byte is odd. */
void fuzz_table(const uint8_t *data, size_t size) {
  size_t bytes = whole_table_bytes;
  uint8_t *frame = fuzz_copy(whole_table, bytes);
  const bool put_right = size % 6 == 0 || !(data[size - 1] & 1);
  for (; size >= 6; size -= 6, data += 6) {
    const size_t at = 4 * (data[0] | (size_t)data[1] << 8);
    if (at + 4 <= bytes) {
      memcpy(frame + at, data + 2, 4);
    } else if (data[2] * (size_t)16 < bytes) {
      bytes -= data[2] * (size_t)16;
    }
  }
  if (put_right &&
      bytes >= WIRE_BYTES_header + bytes_before_words() + CORE_LUT_PIECES * sizeof(float)) {
    wire_table_reply fixed;
    float first, last;
    uint8_t *payload = frame + WIRE_BYTES_header;
    wire_get_table_reply(payload, &fixed);
    const size_t words_at = bytes_before_words();
    const uint32_t payload_bytes = (uint32_t)(bytes - WIRE_BYTES_header);
    memcpy(frame + 16, &payload_bytes, sizeof payload_bytes);
    fixed.parameter_count = fixed.layer_count = 1;
    fixed.word_count = (uint32_t)((payload_bytes - words_at) / sizeof(float));
    fixed.checksum = table_checksum(payload + words_at, fixed.word_count * sizeof(float));
    memcpy(&first, payload + words_at + CORE_LUT_FIRST_MM * sizeof first, sizeof first);
    memcpy(&last, payload + words_at + CORE_LUT_LAST_MM * sizeof last, sizeof last);
    fixed.pieces_from = (double)first;
    fixed.pieces_to = (double)last;
    wire_put_table_reply(payload, &fixed);
  }
  dipole_table *loaded;
  dipole_error error;
  uint8_t *exact = fuzz_copy(frame, bytes);
  if (dipole_table_load(exact, bytes, &loaded, &error)) {
    const uint8_t *kept = dipole_table_bytes(loaded, &bytes);
    check_table(loaded, kept + WIRE_BYTES_header, bytes - WIRE_BYTES_header);
    dipole_table_free(loaded);
  } else {
    CHECK(error.kind == DIPOLE_ERROR_TABLE && error.text[0] != '\0');
  }
  free(exact);
  free(frame);
}

/* ---- surfaces from elsewhere -------------------------------------------------------------------- */

/* Valid surfaces: the frames of table replies, of a dipole, which is small, and of transport. */
enum { SURFACES = 2 };
static struct fuzz_bytes surfaces[SURFACES];

void fuzz_surface_start(void) {
  static const unsigned models[SURFACES] = {CORE_MODEL_BETTER, CORE_MODEL_TRANSPORT};
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_TOLERANCE] = 1;
  for (int i = 0; i < SURFACES; i++) {
    core_varying varying;
    CHECK(core_varying_prepare(&varying, core_isa_select(NULL), models[i], CORE_MOMENTS_EXACT,
                               CORE_EVALUATOR_F32, 0.3, 1.4, &parameters)
              .field == NULL);
    const size_t payload_bytes = table_reply_bytes(&parameters, table_surface_words(&varying));
    const wire_header header = {.magic = WIRE_MAGIC,
                                .version = WIRE_VERSION,
                                .type = WIRE_TYPE_TABLE | WIRE_REPLY,
                                .payload_bytes = (uint32_t)payload_bytes};
    surfaces[i].count = WIRE_BYTES_header + payload_bytes;
    surfaces[i].bytes = malloc(surfaces[i].count);
    CHECK(surfaces[i].bytes != NULL);
    wire_put_header(surfaces[i].bytes, &header);
    table_reply_put_surface(surfaces[i].bytes + WIRE_BYTES_header, &varying, &parameters);
    core_varying_free(&varying);
  }
}

/* Media of all kinds beside the radii of check_table(). */
struct surface_values {
  float sigma_a[RADII], sigma_s[RADII], r[RADII], u[RADII];
};

static void fill_values(struct surface_values *values) {
  static const float ratios[] = {0, 1e-30f, 1e-6f, 0.01f, 0.3f, 1, 30, 1e3f, 1e30f};
  enum { RATIOS = sizeof ratios / sizeof ratios[0] };
  for (int i = 0; i < RADII; i++) {
    const int octave = OCTAVE_FIRST + i / 2;
    const bool last = i >= RADII - 2;
    values->r[i] = last ? (float)(i & 1) / 0.0f : ldexpf(i & 1 ? 1.999f : 1, octave);
    values->r[i] = i == RADII - 2 ? 0 : values->r[i];
    values->u[i] = octave < 0 ? ldexpf(1, octave) : 1 - ldexpf(1, -octave);
    values->sigma_s[i] = i % 11 == 0 ? 0 : i % 13 == 0 ? 1e6f : 1;
    values->sigma_a[i] = ratios[i % RATIOS];
  }
}

/* Asks for values at home, and compares them with those of the portable instruction set. */
static void check_values(const dipole_surface *surface, const core_varying *portable,
                         const dipole_varying_query *query) {
  dipole_varying_result *result;
  dipole_error error;
  float expected[RADII];
  CHECK(dipole_varying_at_home(surface, query, &result, &error));
  CHECK(result->value_count == RADII && result->computed_count <= RADII);
  for (unsigned bit = 1; bit <= query->wanted; bit <<= 1) {
    const float *found = dipole_varying_f32(result, bit);
    if (found == NULL || bit == CORE_QUANTITY_ALBEDO) {
      continue;
    }
    if (bit == CORE_QUANTITY_RADIUS) {
      core_varying_eval(portable, CORE_QUANTITY_RADIUS, RADII, query->sigma_a_per_mm,
                        query->sigma_s_per_mm, query->numbers, expected);
    } else {
      core_varying_eval(portable, bit, RADII, query->sigma_a_per_mm, query->sigma_s_per_mm,
                        query->radii, expected);
    }
    for (int i = 0; i < RADII; i++) { /* beyond the domain of the media both have no value */
      CHECK(found[i] == expected[i] || found[i] != found[i]);
    }
  }
  dipole_varying_result_free(result);
}

static void check_colours(const dipole_surface *surface, dipole_varying_query query,
                          const struct surface_values *values) {
  dipole_varying_result *result;
  dipole_error error;
  query.sigma_a_per_mm = query.sigma_s_per_mm = query.radii = query.numbers = NULL;
  query.colours = values->u;
  query.lengths_mm = values->r;
  query.wanted = 0;
  query.coefficients = CORE_COEFFICIENT_SIGMA_A | CORE_COEFFICIENT_SIGMA_S;
  for (query.given = 1; query.given <= 4; query.given++) {
    for (query.light = 1; query.light <= 2; query.light++) {
      if (dipole_varying_at_home(surface, &query, &result, &error)) {
        dipole_varying_result_free(result);
      } else { /* the surface knows no colours of this light */
        CHECK(error.kind == DIPOLE_ERROR_ARGUMENT && error.text[0] != '\0');
      }
    }
  }
}

static void check_surface(const dipole_surface *surface, const uint8_t *payload,
                          size_t payload_bytes) {
  struct surface_values values;
  core_parameters parameters;
  wire_table_reply fixed;
  core_varying portable;
  const core_medium *layers;
  const float *words;
  fill_values(&values);
  CHECK(table_reply_parse(payload, payload_bytes, &fixed, &layers, &parameters, &words));
  CHECK(core_varying_open(&portable, core_isa_select("portable"), fixed.model, fixed.moments,
                          CORE_EVALUATOR_F32, layers->g, layers->eta, &parameters, words,
                          fixed.word_count)
            .field == NULL);
  dipole_parameter only = {0, 0};
  for (unsigned id = 1; id < CORE_PARAMETERS_END; id++) {
    const double value = parameters.value[id];
    only = value != value ? only : (dipole_parameter){id, value};
  }
  dipole_varying_query query = {.model = fixed.model,
                                .evaluator = DIPOLE_F32,
                                .moments = fixed.moments,
                                .g = layers->g,
                                .eta = layers->eta,
                                .parameters = &only,
                                .parameter_count = only.id > 0,
                                .value_count = RADII,
                                .sigma_a_per_mm = values.sigma_a,
                                .sigma_s_per_mm = values.sigma_s};
  query.radii = values.r;
  query.wanted = CORE_QUANTITY_R | CORE_QUANTITY_CDF | CORE_QUANTITY_PDF | CORE_QUANTITY_RING;
  check_values(surface, &portable, &query);
  query.radii = NULL;
  query.numbers = values.u;
  query.wanted = CORE_QUANTITY_RADIUS | CORE_QUANTITY_ALBEDO;
  check_values(surface, &portable, &query);
  check_colours(surface, query, &values);
  core_varying_free(&portable);
}

/* The target for surfaces. The first byte of an input chooses one. Then it is a row of changes: the
 * number of a word, three bytes, and its new value, four bytes. A number beyond the words cuts the
 * surface short. Afterwards its length and checksum are corrected, unless the first byte is 128 or
 * more. */
void fuzz_surface(const uint8_t *data, size_t size) {
  enum { CHANGE = 7 };
  if (size == 0) {
    return;
  }
  const struct fuzz_bytes *whole = &surfaces[data[0] % 16 == 1]; /* the large one seldom */
  const bool put_right = data[0] < 128;
  size_t bytes = whole->count;
  uint8_t *frame = fuzz_copy(whole->bytes, bytes);
  for (data++, size--; size >= CHANGE; size -= CHANGE, data += CHANGE) {
    const size_t at = 4 * (data[0] | (size_t)data[1] << 8 | (size_t)data[2] << 16);
    if (at + 4 <= bytes) {
      memcpy(frame + at, data + 3, 4);
    } else if (data[3] * (size_t)16 < bytes) {
      bytes -= data[3] * (size_t)16;
    }
  }
  const size_t words_at = WIRE_BYTES_header + bytes_before_words();
  if (put_right && bytes >= words_at) {
    wire_table_reply fixed;
    const uint32_t payload_bytes = (uint32_t)(bytes - WIRE_BYTES_header);
    wire_get_table_reply(frame + WIRE_BYTES_header, &fixed);
    memcpy(frame + 16, &payload_bytes, sizeof payload_bytes);
    fixed.parameter_count = fixed.layer_count = 1;
    fixed.word_count = (uint32_t)((bytes - words_at) / sizeof(float));
    fixed.checksum = table_checksum(frame + words_at, fixed.word_count * sizeof(float));
    wire_put_table_reply(frame + WIRE_BYTES_header, &fixed);
  }
  dipole_surface *loaded;
  dipole_error error;
  uint8_t *exact = fuzz_copy(frame, bytes);
  if (dipole_surface_load(exact, bytes, &loaded, &error)) {
    const uint8_t *kept = dipole_surface_bytes(loaded, &bytes);
    check_surface(loaded, kept + WIRE_BYTES_header, bytes - WIRE_BYTES_header);
    dipole_surface_free(loaded);
  } else {
    CHECK(error.kind == DIPOLE_ERROR_TABLE && error.text[0] != '\0');
  }
  free(exact);
  free(frame);
}

/* ---- answers of a daemon ------------------------------------------------------------------------- */

static bool take_part(void *context, const dipole_result *part, uint64_t radius_first) {
  const uint64_t *limit = context;
  return part->radius_count + radius_first < *limit;
}

static bool see_progress(void *context, const dipole_mc_progress *now) {
  const uint64_t *limit = context;
  return now->photons < *limit;
}

/* Makes the call whose answer has this type. */
static bool ask(dipole_client *client, unsigned type, unsigned how, dipole_error *error) {
  static const dipole_medium media[] = {{0.032, 0.74, 0, 1.3}, {0.17, 0.88, 0, 1.3}};
  static const double radii[] = {0.5, 1}, albedos[] = {0.5, 0.3, 1, 0.7};
  double values[16], into_radii[2];
  const bool into = how & 1;
  dipole_query query = {.model = CORE_MODEL_BETTER,
                        .evaluator = DIPOLE_F64,
                        .moments = DIPOLE_EXACT,
                        .wanted = how >> 4 ? how >> 4 : 7,
                        .media = media,
                        .medium_count = 1 + (how >> 1 & 1),
                        .spacing = DIPOLE_LIST,
                        .radii = radii,
                        .radius_count = 2,
                        .into_values = into ? values : NULL,
                        .into_radii = into ? into_radii : NULL};
  uint64_t limit = 2;
  bool good;
  switch (type) {
  case WIRE_TYPE_EVAL: {
    dipole_result *result = NULL;
    if (how & 4) {
      return dipole_eval_parts(client, &query, take_part, &limit, error);
    }
    good = dipole_eval(client, &query, &result, error);
    dipole_result_free(result);
    return good;
  }
  case WIRE_TYPE_SAMPLE: {
    dipole_result *result = NULL;
    const dipole_sample_query sample = {.model = CORE_MODEL_BETTER,
                                        .evaluator = DIPOLE_F64,
                                        .moments = DIPOLE_EXACT,
                                        .wanted = query.wanted,
                                        .media = media,
                                        .medium_count = query.medium_count,
                                        .draw = DIPOLE_DRAW_REGULAR,
                                        .sample_count = 4};
    good = dipole_sample(client, &sample, &result, error);
    dipole_result_free(result);
    return good;
  }
  case WIRE_TYPE_INVERT: {
    dipole_inversion *inversion = NULL;
    const dipole_invert_query invert = {.model = CORE_MODEL_BETTER,
                                        .moments = DIPOLE_EXACT,
                                        .given = DIPOLE_MEAN_FREE_PATH,
                                        .eta = 1.3,
                                        .albedos = albedos,
                                        .lengths_mm = radii,
                                        .medium_count = query.medium_count};
    good = dipole_invert(client, &invert, &inversion, error);
    dipole_inversion_free(inversion);
    return good;
  }
  case WIRE_TYPE_FIT: {
    dipole_fits *fits = NULL;
    const dipole_fit_query fit = {.model = CORE_MODEL_BETTER,
                                  .moments = DIPOLE_EXACT,
                                  .eta = 1.3,
                                  .axis = DIPOLE_AXIS_RADIUS,
                                  .scale = how & 8 ? DIPOLE_REFERENCE : DIPOLE_ABSOLUTE,
                                  .reference = media[0],
                                  .reading_count = 2,
                                  .at = radii,
                                  .set_count = query.medium_count / 2 + 1,
                                  .values = albedos,
                                  .errors = albedos,
                                  .residuals = into};
    good = dipole_fit(client, &fit, &fits, error);
    dipole_fits_free(fits);
    return good;
  }
  case WIRE_TYPE_FIT_LAYERS: {
    dipole_layers_fit *fit = NULL;
    const dipole_layers_query layers = {.layers = media,
                                        .layer_count = 1,
                                        .unknowns = DIPOLE_SIGMA_A_1 | DIPOLE_SIGMA_S_1,
                                        .scale = DIPOLE_ABSOLUTE,
                                        .reading_count = 2,
                                        .at = radii,
                                        .values = albedos,
                                        .errors = albedos};
    good = dipole_fit_layers(client, &layers, &fit, error);
    dipole_layers_fit_free(fit);
    return good;
  }
  case WIRE_TYPE_TISSUE: {
    dipole_medium found[2];
    const dipole_parameter water = {.id = 3, .value = 0.7};
    const dipole_tissue_query tissue = {.tissue = 8,
                                        .haemoglobin = DIPOLE_PRAHL,
                                        .properties = &water,
                                        .property_count = 1,
                                        .wavelengths_nm = radii,
                                        .wavelength_count = 2};
    return dipole_tissue(client, &tissue, found, error);
  }
  case WIRE_TYPE_FIT_TISSUE: {
    dipole_tissue_fits *fits = NULL;
    const dipole_parameter scattering[] = {{.id = 32, .value = 2}, {.id = 33, .value = 1}};
    const dipole_sought blood[] = {{.property = 1}, {.property = 2}};
    const dipole_tissue_fit_query fit = {.tissue = {0, DIPOLE_PRAHL, scattering, 2, radii, 2, 0},
                                         .model = CORE_MODEL_BETTER,
                                         .axis = DIPOLE_AXIS_RADIUS,
                                         .scale = DIPOLE_ABSOLUTE,
                                         .sought = blood,
                                         .sought_count = 2,
                                         .place_count = 1,
                                         .at = radii,
                                         .set_count = query.medium_count / 2 + 1,
                                         .values = albedos,
                                         .errors = albedos,
                                         .residuals = into};
    good = dipole_fit_tissue(client, &fit, &fits, error);
    dipole_tissue_fits_free(fits);
    return good;
  }
  case WIRE_TYPE_VARYING: {
    dipole_varying_result *result = NULL;
    const dipole_varying_query varying = {.model = CORE_MODEL_BETTER,
                                          .evaluator = DIPOLE_F64,
                                          .moments = DIPOLE_EXACT,
                                          .wanted = DIPOLE_R,
                                          .coefficients = DIPOLE_SIGMA_A,
                                          .eta = 1.3,
                                          .sigma_a_per_mm = albedos,
                                          .sigma_s_per_mm = radii,
                                          .radii = radii,
                                          .value_count = query.medium_count};
    good = dipole_varying(client, &varying, &result, error);
    dipole_varying_result_free(result);
    return good;
  }
  case WIRE_TYPE_GATHER: {
    static const double places[6] = {0, 0, 0, 1, 0, 0};
    static const float powers[2] = {1, 2};
    dipole_points *points;
    double M[2];
    CHECK(dipole_points_make(2, 1, places, powers, &points, error));
    const dipole_gather_query gather = {.model = CORE_MODEL_BETTER,
                                        .evaluator = DIPOLE_F64,
                                        .moments = DIPOLE_EXACT,
                                        .points = points,
                                        .media = media,
                                        .queries_mm = places,
                                        .query_count = 2,
                                        .tolerance = 0.1};
    good = dipole_gather(client, &gather, NULL, NULL, M, NULL, error);
    dipole_points_free(points);
    return good;
  }
  case WIRE_TYPE_MC: {
    dipole_mc_result *result = NULL;
    const dipole_mc_query mc = {.medium = media[0],
                                .albedos = albedos,
                                .albedo_count = how >> 1 & 3,
                                .layers = how & 8 ? media : NULL,
                                .layer_count = 2,
                                .spacing = DIPOLE_LINEAR,
                                .ring_count = 2 + (how >> 4),
                                .radius_stop_mm = 1,
                                .photons = 8};
    good = dipole_mc(client, &mc, into ? see_progress : NULL, &limit, &result, error);
    dipole_mc_result_free(result);
    return good;
  }
  case WIRE_TYPE_TABLE: {
    dipole_table *fetched = NULL;
    const dipole_table_query asked = {
        .model = CORE_MODEL_BETTER, .moments = DIPOLE_EXACT, .medium = media[0]};
    good = dipole_table_fetch(client, &asked, &fetched, error);
    dipole_table_free(fetched);
    return good;
  }
  case WIRE_TYPE_MEDIA: {
    dipole_measured_medium *measured = NULL;
    size_t count;
    good = dipole_media(client, &measured, &count, error);
    free(measured);
    return good;
  }
  case WIRE_TYPE_STATS: {
    dipole_value *statistics = NULL;
    size_t count;
    good = dipole_statistics(client, &statistics, &count, error);
    free(statistics);
    return good;
  }
  case WIRE_TYPE_PING:
    return dipole_ping(client, error);
  default:
    free(client->info);
    client->info = NULL;
    return libdipole_hello(client, "fuzz", error);
  }
}

/* The target for a client. The first byte of an input says which call the client makes, and the
 * second how. The other bytes are the daemon's answer. */
void fuzz_replies(const uint8_t *data, size_t size) {
  int fds[2];
  if (size < 2 + WIRE_BYTES_header || size > 65536) {
    return;
  }
  wire_header header;
  wire_get_header(data + 2, &header);
  dipole_client *client = calloc(1, sizeof *client);
  dipole_error error = {0};
  CHECK(client != NULL && dipole_local_info(&client->info, &error));
  CHECK(socketpair(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0, fds) == 0);
  CHECK(send(fds[1], data + 2, size - 2, MSG_NOSIGNAL) == (ssize_t)(size - 2));
  shutdown(fds[1], SHUT_WR);
  libdipole_stream_init(&client->stream, fds[0]);
  client->last_id = header.request_id - 1 < UINT64_MAX - 2 ? header.request_id - 1 : 0;
  client->in_flight_max = 16;
  for (int call = 0; call < 2; call++) {
    error = (dipole_error){0};
    const bool good = ask(client, data[0], data[1], &error);
    CHECK(good == (error.kind == DIPOLE_ERROR_NONE));
  }
  close(fds[1]);
  dipole_close(client);
}
