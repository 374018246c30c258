/* Calls of the installed library that nothing else makes: surfaces, gathers that end early, and what
 * fits of layers leave. Prints what does not hold. argv[1]: the address of a daemon */
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

int main(int argc, char **argv) {
  dipole_client *client;
  CHECK(argc == 2 && dipole_open(argv[1], &client, NULL));
  const unsigned transport = dipole_id(client, DIPOLE_MODEL, "transport");
  check_surface(client, transport);
  check_gather(client, transport);
  check_layers(client);
  check_call(client);
  dipole_close(client);
  return failures != 0;
}
