#include "clients/cli/plot_rings.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/progress.h"
#include "core/gauss.h"

/* A ring is cut into parts whose outer edge is at most twice the inner one, since R may fall by
 * orders of magnitude within a ring. A ring that starts at 0 is cut into so many octaves and the
 * rest of it. */
enum { OCTAVES_OF_DISC = 16, NODES = 2 * CORE_GAUSS_HALF };

/* ---- rings ----------------------------------------------------------------------------------- */

/* Adds the rule's nodes from from_mm to to_mm. share: of their weights in the mean; sign: in what
 * its error is told from. */
static void add_rule(cli_rings *rings, size_t ring, double from_mm, double to_mm, double share,
                     double sign) {
  const size_t first = rings->node_count;
  rings->node_count += NODES;
  rings->nodes_mm = cli_resize(rings->nodes_mm, rings->node_count, sizeof *rings->nodes_mm);
  rings->weights = cli_resize(rings->weights, rings->node_count, sizeof *rings->weights);
  for (int i = 0; i < NODES; i++) {
    const double weight_mm = (to_mm - from_mm) * core_gauss_weight(i);
    rings->nodes_mm[first + (size_t)i] = from_mm + (to_mm - from_mm) * core_gauss_node(i);
    rings->weights[first + (size_t)i] = (cli_weight){ring, share * weight_mm, sign * weight_mm};
  }
}

/* The power of a part is the sum of its halves'; the rule over the whole part tells the error. */
static void add_part(cli_rings *rings, size_t ring, double from_mm, double to_mm) {
  const double middle_mm = (from_mm + to_mm) / 2;
  add_rule(rings, ring, from_mm, middle_mm, 1, 1);
  add_rule(rings, ring, middle_mm, to_mm, 1, 1);
  add_rule(rings, ring, from_mm, to_mm, 0, -1);
}

static void add_ring(cli_rings *rings, size_t ring) {
  const double from_mm = rings->edges_mm[ring], to_mm = rings->edges_mm[ring + 1];
  const double first_mm = from_mm > 0 ? from_mm : ldexp(to_mm, -OCTAVES_OF_DISC);
  const int octaves = (int)fmax(ceil(log2(to_mm / first_mm)), 1);
  double low_mm = from_mm;
  for (int i = from_mm > 0 ? 1 : 0; i <= octaves; i++) {
    const double high_mm =
        i < octaves ? first_mm * pow(to_mm / first_mm, (double)i / octaves) : to_mm;
    add_part(rings, ring, low_mm, high_mm);
    low_mm = high_mm;
  }
}

cli_rings cli_rings_make(double from_mm, double to_mm, bool logarithmic, size_t count) {
  cli_rings rings = {.spacing = logarithmic ? DIPOLE_LOGARITHMIC : DIPOLE_LINEAR,
                     .count = count,
                     .edges_mm = cli_allocate(count + 1, sizeof(double))};
  for (size_t i = 0; i <= count; i++) {
    const double share = (double)i / (double)count;
    rings.edges_mm[i] =
        logarithmic ? from_mm * pow(to_mm / from_mm, share) : from_mm + (to_mm - from_mm) * share;
  }
  rings.edges_mm[count] = to_mm;
  for (size_t i = 0; i < count; i++) {
    add_ring(&rings, i);
  }
  return rings;
}

void cli_rings_free(cli_rings *rings) {
  free(rings->edges_mm);
  free(rings->nodes_mm);
  free(rings->weights);
  *rings = (cli_rings){0};
}

/* ---- means of models ------------------------------------------------------------------------- */

void cli_rings_take_means(const cli_rings *rings, cli_eval_report *report) {
  const double pi = acos(-1), *edges_mm = rings->edges_mm;
  for (size_t k = 0; k < report->model_count * report->profile.channel_count; k++) {
    cli_eval_values *values = &report->values[k];
    double *powers = cli_allocate(rings->count, sizeof *powers);
    double *errors = cli_allocate(rings->count, sizeof *errors), worst = 0;
    for (size_t i = 0; i < rings->node_count; i++) {
      const cli_weight *weight = &rings->weights[i];
      powers[weight->ring] += weight->mm * values->arrays[0][i];
      errors[weight->ring] += weight->error_mm * values->arrays[0][i];
    }
    for (size_t i = 0; i < rings->count; i++) {
      worst = powers[i] > 0 ? fmax(worst, fabs(errors[i]) / powers[i]) : worst;
      powers[i] /= pi * (edges_mm[i + 1] * edges_mm[i + 1] - edges_mm[i] * edges_mm[i]);
    }
    free(errors);
    free(values->arrays[0]);
    values->arrays[0] = powers;
    values->numerical_error += worst;
  }
  report->quantities.items[0] = cli_choice_of_id(report->profile.info, DIPOLE_QUANTITY, DIPOLE_R);
  report->quantities.wanted = DIPOLE_R;
  report->radius_count = rings->count;
  for (size_t i = 0; i < rings->count; i++) {
    report->radii[i] = hypot(edges_mm[i], edges_mm[i + 1]) / sqrt(2);
  }
}

/* ---- Monte Carlo ----------------------------------------------------------------------------- */

/* Adds a model, as the last but an unlisted one. Returns its values, [channel_count]. */
static cli_eval_values *insert_model(cli_eval_report *report, const dipole_choice *choice) {
  const size_t channels = report->profile.channel_count;
  const size_t after = report->models[report->model_count - 1].unlisted ? 1 : 0;
  const size_t at = report->model_count++ - after;
  report->models = cli_resize(report->models, report->model_count, sizeof *report->models);
  memmove(&report->models[at + 1], &report->models[at], after * sizeof *report->models);
  report->models[at] = (cli_eval_model){.choice = choice, .named = true};
  report->values =
      cli_resize(report->values, report->values_capacity + channels, sizeof *report->values);
  cli_eval_values *values = report->values + at * channels;
  memmove(values + channels, values, (report->values_capacity - at * channels) * sizeof *values);
  report->values_capacity += channels;
  for (size_t i = 0; i < channels; i++) {
    values[i] = (cli_eval_values){.albedo = (double)NAN, .model_error = (double)NAN};
    values[i].arrays[0] = cli_allocate(report->radius_count, sizeof(double));
  }
  return values;
}

typedef struct walk {
  cli_progress progress;
  size_t channel, channels;
} walk;

static bool follow(void *context, const dipole_mc_progress *now) {
  walk *of = context;
  const double expected = (double)now->photons_expected, done = (double)now->photons;
  cli_progress_show(&of->progress,
                    ((double)of->channel + done / fmax(expected, done)) / (double)of->channels,
                    done);
  return true;
}

int cli_rings_walk(const cli_rings *rings, double photons, double thickness_mm,
                   dipole_client *client, cli_eval_report *report) {
  static const dipole_choice R_error = {
      .kind = DIPOLE_QUANTITY, .name = "R_error", .about = "1/mm^2"};
  walk of = {.channels = report->profile.channel_count};
  dipole_error error = {0};
  bool good = true;
  cli_eval_values *values = insert_model(report, &cli_monte_carlo);
  const size_t at = cli_eval_add_quantity(report, &R_error);
  cli_progress_start(&of.progress, "photons");
  for (; good && of.channel < of.channels; of.channel++) {
    const dipole_mc_query query = {.medium = report->profile.media[of.channel],
                                   .thickness_mm = thickness_mm,
                                   .spacing = rings->spacing,
                                   .ring_count = (uint32_t)rings->count,
                                   .radius_start_mm = rings->edges_mm[0],
                                   .radius_stop_mm = rings->edges_mm[rings->count],
                                   .seed = 1,
                                   .photons = (uint64_t)photons};
    double *const *arrays = values[of.channel].arrays;
    dipole_mc_result *result = NULL;
    good = dipole_mc(client, &query, follow, &of, &result, &error);
    for (size_t i = 0; good && i < rings->count; i++) {
      arrays[0][i] = dipole_mc_values(result, 0, DIPOLE_MC_REFLECTED)[i];
      arrays[at][i] = dipole_mc_errors(result, 0, DIPOLE_MC_REFLECTED)[i];
    }
    dipole_mc_result_free(result);
  }
  cli_progress_wipe(&of.progress);
  return good ? CLI_OK : cli_fail_error(&error);
}
