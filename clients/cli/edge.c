#include "clients/cli/edge.h"

#include <math.h>
#include <string.h>

#include "clients/cli/profile.h"
#include "core/core.h"

bool cli_edge_radii(const cli_settings *settings, dipole_client *client, const dipole_medium *media,
                    uint32_t layer_count, size_t count, double **r_mm, double *colours,
                    double *errors) {
  dipole_result *result;
  dipole_error error;
  const dipole_sample_query query = {.model = CORE_MODEL_TRANSPORT,
                                     .evaluator = DIPOLE_F64,
                                     .moments = DIPOLE_EXACT,
                                     .wanted = DIPOLE_RADIUS | DIPOLE_ALBEDO,
                                     .media = media,
                                     .layer_count = layer_count,
                                     .medium_count = (uint32_t)count,
                                     .draw = DIPOLE_DRAW_REGULAR,
                                     .sample_count = CLI_EDGE_RADII};
  if (!CLI_RETRY(settings, &error, dipole_sample(client, &query, &result, &error))) {
    return cli_fail_error(&error) == CLI_OK;
  }
  *r_mm = cli_allocate(count * CLI_EDGE_RADII, sizeof **r_mm);
  for (size_t i = 0; i < count; i++) {
    memcpy(*r_mm + i * CLI_EDGE_RADII, dipole_values_f64(result, (uint32_t)i, DIPOLE_RADIUS),
           CLI_EDGE_RADII * sizeof **r_mm);
    if (colours != NULL) {
      colours[i] = result->channels[i].albedo;
    }
    if (errors != NULL) {
      errors[i] = result->channels[i].numerical_error;
    }
  }
  dipole_result_free(result);
  for (size_t i = 0; i < count; i++) {
    if (!((*r_mm)[i * CLI_EDGE_RADII] > 0)) {
      return cli_fails("channel %zu: it does not scatter: no light leaves beside where it entered",
                       i + 1);
    }
  }
  return true;
}

double cli_edge_at(const double *r_mm, double x_mm) {
  const double x = fabs(x_mm), quarter = asin(1);
  /* invariant: all radii with an index below `low` are at most x */
  size_t low = 0, high = CLI_EDGE_RADII;
  while (low < high) {
    const size_t middle = (low + high) / 2;
    *(r_mm[middle] <= x ? &low : &high) = r_mm[middle] <= x ? middle + 1 : middle;
  }
  double sum = (double)low * quarter;
  for (size_t i = low; i < CLI_EDGE_RADII; i++) {
    sum += asin(x / r_mm[i]);
  }
  return 0.5 + copysign(sum / (2 * quarter * CLI_EDGE_RADII), x_mm);
}

/* ---- Burley's profile ------------------------------------------------------------------------ */

/* Numbers of places to compare edges at, quantiles of the radii, and of steps of the search. */
enum { PLACES = 96, STEPS = 40 };

/* Returns the radius at which the cdf of Burley's profile with d = 1 is u: the inverse of 1 - e^-x /
 * 4 - 3 e^(-x / 3) / 4 (Golubev 2018). */
static double burley_radius(double u) {
  const double w = 1 - u, G = 1 + 4 * w * (2 * w + sqrt(1 + 4 * w * w)), root = cbrt(G);
  return 3 * log((1 + 1 / root + root) / (4 * w));
}

double cli_edge_burley(const double *r_mm, double *error) {
  static double burley[CLI_EDGE_RADII];
  double x[PLACES], wanted[PLACES], worst = 0;
  for (size_t i = 0; i < CLI_EDGE_RADII; i++) {
    burley[i] = burley_radius(((double)i + 0.5) / CLI_EDGE_RADII);
  }
  for (size_t i = 0; i < PLACES; i++) {
    x[i] = r_mm[(2 * i + 1) * CLI_EDGE_RADII / (2 * PLACES)];
    wanted[i] = cli_edge_at(r_mm, x[i]);
  }
  /* Each difference is negative below some d and positive above it. So the largest absolute value
   * has a single minimum, which golden-section search finds. */
  double low = log(0.02 * x[PLACES / 2]), high = log(4 * x[PLACES / 2]), d = 0;
  const double ratio = (sqrt(5) - 1) / 2;
  double at[2] = {high - ratio * (high - low), low + ratio * (high - low)}, off[2];
  for (int step = 0, which = -1; step < STEPS; step++) {
    for (int k = 0; k < 2; k++) {
      if (which < 0 || k == which) {
        off[k] = 0;
        for (size_t i = 0; i < PLACES; i++) {
          off[k] = fmax(off[k], fabs(cli_edge_at(burley, x[i] / exp(at[k])) - wanted[i]));
        }
      }
    }
    which = off[0] < off[1] ? 0 : 1;
    d = exp(at[which]);
    worst = off[which];
    if (which == 0) {
      high = at[1], at[1] = at[0], off[1] = off[0], at[0] = high - ratio * (high - low);
    } else {
      low = at[0], at[0] = at[1], off[0] = off[1], at[1] = low + ratio * (high - low);
    }
  }
  if (error != NULL) {
    *error = worst + CLI_EDGE_ERROR;
  }
  return d;
}
