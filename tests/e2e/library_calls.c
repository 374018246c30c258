/* Calls of the installed library that nothing else makes: surfaces, gathers that end early, and what
 * fits of layers leave. Prints what does not hold. argv: the
 * addresses of a daemon, and of one with small frames */
#include <dipole.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { VALUES = 64, POINTS = 20000, QUERIES = 30000 };

static int failures;
#define CHECK(that) ((that) ? (void)0 : (void)(failures++, printf("%d: %s\n", __LINE__, #that)))

static double xyz[POINTS][3], queries[QUERIES][3], whole[QUERIES], part[QUERIES];
static float power[POINTS];

static bool once(void *calls, uint64_t done, uint64_t count) {
  ++*(int *)calls;
  return done > count;
}

static void check_surface(dipole_client *client, unsigned transport) {
  const dipole_table_query asked = {transport, DIPOLE_EXACT, {0, 0, .5, 1.4, 0}, .layer_count = 1};
  double a[VALUES], s[VALUES], r[VALUES];
  dipole_varying_query query = {.model = transport,
                                .evaluator = DIPOLE_F64,
                                .moments = DIPOLE_EXACT,
                                .wanted = DIPOLE_R,
                                .g = .5,
                                .eta = 1.4,
                                .sigma_a_per_mm = a,
                                .sigma_s_per_mm = s,
                                .radii = r,
                                .value_count = VALUES};
  dipole_varying_result *here, *there;
  dipole_surface *fetched, *loaded;
  dipole_error error;
  size_t bytes;
  for (int i = 0; i < VALUES; i++) {
    a[i] = .01 * i, s[i] = 1 + .1 * i, r[i] = .05 * (i + 1);
  }
  CHECK(dipole_surface_fetch(client, &asked, &fetched, &error));
  const void *frame = dipole_surface_bytes(fetched, &bytes);
  uint8_t *damaged = memcpy(malloc(bytes), frame, bytes);
  damaged[bytes - 1] ^= 1;
  CHECK(!dipole_surface_load(damaged, bytes, &loaded, &error) && error.kind == DIPOLE_ERROR_TABLE);
  free(damaged);
  CHECK(dipole_surface_load(frame, bytes, &loaded, &error));
  CHECK(dipole_varying_at_home(loaded, &query, &here, &error));
  CHECK(dipole_varying(client, &query, &there, &error));
  CHECK(here->computed_count == VALUES && there->computed_count == VALUES);
  CHECK(memcmp(dipole_varying_f64(here, DIPOLE_R), dipole_varying_f64(there, DIPOLE_R), sizeof a) ==
        0);
  dipole_varying_result_free(here);
  query.eta = 1.3;
  CHECK(!dipole_varying_at_home(loaded, &query, &here, &error) &&
        strstr(error.text, "the surface is"));
  dipole_varying_result_free(there);
  dipole_surface_free(fetched);
  dipole_surface_free(loaded);
}

static void check_gather(dipole_client *client, unsigned transport) {
  const dipole_medium medium = {.03, 1, 0, 1.3, 0};
  dipole_gather_result all, some;
  dipole_points *points = NULL;
  dipole_error error;
  int calls = 0;
  size_t missing = 0, same = 0;
  for (size_t i = 0; i < QUERIES; i++) { /* points on a spiral, and queries above it */
    const double angle = .1 * (double)i, far = .001 * (double)(i % POINTS);
    memcpy(queries[i], (double[]){far * cos(angle), far * sin(angle), .1}, sizeof queries[i]);
    memcpy(xyz[i % POINTS], (double[]){far * sin(angle), far * cos(angle), 0}, sizeof xyz[0]);
    power[i % POINTS] = 1;
  }
  CHECK(dipole_points_make(POINTS, 1, xyz[0], power, &points, &error));
  dipole_gather_query query = {.model = transport,
                               .evaluator = DIPOLE_LUT,
                               .moments = DIPOLE_EXACT,
                               .points = points,
                               .media = &medium,
                               .queries_mm = queries[0],
                               .query_count = QUERIES,
                               .tolerance = .01};
  CHECK(dipole_gather(client, &query, NULL, NULL, whole, &all, &error));
  CHECK(all.computed_count == QUERIES && all.bound > 0 && all.bound <= .01);
  CHECK(!(all.model_error[0] > 0 || all.model_error[0] < 0) && all.numerical_error[0] > 0);
  CHECK(dipole_gather(client, &query, once, &calls, part, &some, &error));
  for (size_t i = 0; i < QUERIES; i++) {
    missing += isnan(part[i]);
    same += memcmp(&part[i], &whole[i], sizeof part[i]) == 0;
  }
  CHECK(calls == 1 && missing > 0 && missing + same == QUERIES && same == some.computed_count);
  query.tolerance = 0, query.deadline_ms = 1;
  CHECK(!dipole_gather(client, &query, NULL, NULL, part, NULL, &error) &&
        error.kind == DIPOLE_ERROR_REFUSED);
  CHECK(strcmp(error.field, "deadline_ms") == 0);
  query.query_count = 0, query.deadline_ms = 0;
  CHECK(dipole_gather(client, &query, NULL, NULL, part, &some, &error) && some.computed_count == 0);
  dipole_points_free(points);
}

/* A reading that the fit takes away has no residual, whatever its error. */
static void check_layers(dipole_client *client) {
  const dipole_medium layer = {.01, .74, 0, 1.3, 0};
  const double at = 3, value = 2.7e-3, error = 1e-5;
  dipole_layers_fit *fit = NULL;
  const dipole_layers_query query = {.layers = &layer,
                                     .layer_count = 1,
                                     .unknowns = DIPOLE_SIGMA_A_1,
                                     .scale = DIPOLE_ABSOLUTE,
                                     .reading_count = 1,
                                     .at = &at,
                                     .values = &value,
                                     .errors = &error};
  CHECK(dipole_fit_layers(client, &query, &fit, NULL) && fit->estimate_count == 1);
  CHECK(fit->reading_count == 1 && fabs(fit->residuals[0]) < .01);
  CHECK(fabs(fit->estimates[0].value - .0314) < 1e-4 && fit->status == DIPOLE_FITTED);
  dipole_layers_fit_free(fit);
}

/* Any message by its name: an answer, a refusal, and what the library refuses itself. */
static void check_call(dipole_client *client) {
  const double nm[] = {600, 700};
  const dipole_parameter blood = {dipole_id(client, DIPOLE_PROPERTY, "hbo2_uM"), 50};
  dipole_field given[] = {{"tissue", .number = 1},
                          {"property", .elements = &blood, .count = 1},
                          {"wavelength", .elements = nm, .count = 2}};
  const dipole_tissue_query query = {1, DIPOLE_PRAHL, &blood, 1, nm, 2, 0};
  dipole_medium media[2];
  dipole_reply *reply;
  dipole_error error;
  uint64_t count;
  CHECK(dipole_call(client, "tissue", given, 3, 0, &reply, &error));
  CHECK(dipole_tissue(client, &query, media, &error));
  CHECK(memcmp(dipole_reply_array(reply, "media", &count), media, sizeof media) == 0 && count == 2);
  CHECK(dipole_reply_number(reply, "haemoglobin") == DIPOLE_PRAHL);
  CHECK(isnan(dipole_reply_number(reply, "x")) && dipole_reply_array(reply, "x", &count) == NULL);
  dipole_reply_free(reply);
  given[0].number = 65535;
  CHECK(!dipole_call(client, "tissue", given, 3, 0, &reply, &error));
  CHECK(error.kind == DIPOLE_ERROR_REFUSED && strcmp(error.field, "tissue") == 0);
  given[0].name = "colour";
  CHECK(!dipole_call(client, "tissue", given, 3, 0, &reply, &error) &&
        strstr(error.text, "colour"));
  CHECK(!dipole_call(client, "eval", NULL, 0, 0, &reply, &error) && strstr(error.text, "eval"));
}

/* What many sets of one request count together: their replies come in parts. Of each the first and the
 * last have no answer. `frugal` is a daemon with small frames. */
static void check_counts(dipole_client *frugal) {
  enum { SETS = 1500, READINGS = 2 };
  const unsigned better = dipole_id(frugal, DIPOLE_MODEL, "better");
  static double albedos[SETS], lengths[SETS], values[SETS][READINGS], errors[SETS][READINGS];
  const double at[] = {1, 4}, nm = 700;
  const dipole_parameter scattering[] = {{dipole_id(frugal, DIPOLE_PROPERTY, "a_per_mm"), 1},
                                         {dipole_id(frugal, DIPOLE_PROPERTY, "b"), 1}};
  const dipole_sought sought = {.property = dipole_id(frugal, DIPOLE_PROPERTY, "hbo2_uM")};
  dipole_inversion *media;
  dipole_fits *fits;
  dipole_tissue_fits *tissues;
  dipole_error error;
  for (int i = 0; i < SETS; i++) {
    const bool is_end = i == 0 || i == SETS - 1;
    albedos[i] = is_end ? 1 : .3; /* without absorption there is no diffuse path */
    lengths[i] = 1;
    values[i][0] = is_end ? NAN : .0127178, values[i][1] = .0015157;
    errors[i][0] = .00025, errors[i][1] = .00003;
  }
  dipole_invert_query inverted = {.model = better,
                                  .moments = DIPOLE_EXACT,
                                  .given = DIPOLE_DIFFUSE_MEAN_FREE_PATH,
                                  .eta = 1.4,
                                  .albedos = albedos,
                                  .lengths_mm = lengths,
                                  .medium_count = SETS};
  CHECK(dipole_invert(frugal, &inverted, &media, &error));
  CHECK(media->medium_count == SETS && media->missing_count == 2);
  dipole_inversion_free(media);
  inverted.model = dipole_id(frugal, DIPOLE_MODEL, "transport");
  inverted.albedos = albedos + 1, inverted.medium_count = 64, inverted.deadline_ms = 1;
  CHECK(!dipole_invert(frugal, &inverted, &media, &error) &&
        strcmp(error.field, "deadline_ms") == 0);
  CHECK(dipole_fit(frugal,
                   &(dipole_fit_query){.model = better,
                                       .moments = DIPOLE_EXACT,
                                       .axis = DIPOLE_AXIS_RADIUS,
                                       .scale = DIPOLE_ABSOLUTE,
                                       .eta = 1.4,
                                       .reading_count = READINGS,
                                       .at = at,
                                       .set_count = SETS,
                                       .values = values[0],
                                       .errors = errors[0]},
                   &fits, &error));
  CHECK(fits->set_count == SETS && fits->fitted_count == SETS - 2);
  dipole_fits_free(fits);
  CHECK(dipole_fit_tissue(
      frugal,
      &(dipole_tissue_fit_query){.tissue = {0, DIPOLE_PRAHL, scattering, 2, &nm, 1, 0},
                                 .model = better,
                                 .axis = DIPOLE_AXIS_RADIUS,
                                 .scale = DIPOLE_ABSOLUTE,
                                 .sought = &sought,
                                 .sought_count = 1,
                                 .place_count = READINGS,
                                 .at = at,
                                 .set_count = SETS,
                                 .values = values[0],
                                 .errors = errors[0]},
      &tissues, &error));
  CHECK(tissues->set_count == SETS && tissues->fitted_count == SETS - 2);
  dipole_tissue_fits_free(tissues);
}

int main(int argc, char **argv) {
  dipole_client *client, *frugal;
  CHECK(argc == 3 && dipole_open(argv[1], &client, NULL) && dipole_open(argv[2], &frugal, NULL));
  const unsigned transport = dipole_id(client, DIPOLE_MODEL, "transport");
  check_surface(client, transport);
  check_gather(client, transport);
  check_layers(client);
  check_call(client);
  check_counts(frugal);
  dipole_close(client);
  dipole_close(frugal);
  return failures != 0;
}
