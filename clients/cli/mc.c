/* dipole mc: a Monte Carlo job on the daemon, followed until its table is there. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/options.h"
#include "clients/cli/profile.h"
#include "clients/cli/progress.h"
#include "clients/cli/rows.h"
#include "proto/decimal.h"

static const cli_option options[] = {
    CLI_TITLE("Walks"),
    CLI_OPTION(NUMBERS, albedo, NULL,
               "up to 16 single-scattering albedos in place of the medium's own; the same walks "
               "serve all"),
    CLI_TITLE("Rings"),
    CLI_OPTION(NUMBERS, r, NULL,
               "in place of rings: R at these radii above 0, mm, from rings 3 % wide. --format csv "
               "is then a file that `dipole fit` reads"),
    CLI_OPTION(NUMBER, from, NULL, "inner edge of the first ring, mm (default: 0)"),
    CLI_OPTION(NUMBER, to, "10", "outer edge of the last ring, mm"),
    CLI_OPTION(COUNT32, rings, "20", "how many rings there are"),
    CLI_OPTION(SWITCH, log, NULL,
               "make the ratios between edges equal instead of the steps; needs --from"),
    CLI_TITLE("Effort"),
    CLI_OPTION(NUMBER, photons, "1e6",
               "how many photons walk, such as 2e6 (with --error or --total-error, as many as the "
               "daemon allows)"),
    CLI_OPTION(NUMBER, error, NULL,
               "end when the relative standard error of each ring with light is so small"),
    CLI_OPTION(NUMBER, total_error, NULL,
               "end when that of the total R is so small; with --error, when both are"),
    CLI_OPTION(COUNT, seed, "1", "seed of the random numbers; the same seed gives the same bits"),
    {0},
};

typedef struct report {
  const cli_profile *profile;
  const char *medium;   /* name of the measured medium; NULL: none, or several */
  const char *channel;  /* the name of the channel */
  const cli_numbers *r; /* radii for `dipole fit`; none: rings are written */
  dipole_mc_query query;
  dipole_mc_result *result;
} report;

/* ---- without a daemon ------------------------------------------------------------------------ */

static int check(cli_settings *settings) {
  const double photons = settings->photons.value;
  const int status = cli_medium_check(settings);
  if (status != CLI_OK) {
    return status;
  }
  if (settings->r.count > 0 &&
      (settings->from.given || settings->to.given || settings->rings.given || settings->log)) {
    return cli_fail_usage(
        "--r gives the radii one by one: leave --from, --to, --rings and --log out");
  }
  for (size_t i = 0; i < settings->r.count; i++) {
    if (!(settings->r.items[i] > 0 && isfinite(settings->r.items[i]))) {
      return cli_fail_usage("--r: give radii above 0");
    }
  }
  if (settings->log && !settings->from.given) {
    return cli_fail_usage("--log needs --from, above 0");
  }
  if (!(photons >= 1 && photons <= 0x1p53 && photons == floor(photons))) {
    return cli_fail_usage("--photons: give a whole number from 1 to 9e15, such as 2000000 or 2e6");
  }
  return CLI_OK;
}

/* ---- the query ------------------------------------------------------------------------------- */

/* Returns how many photons may walk. If an error is requested, only the daemon limits them. */
static uint64_t photons_of(const cli_settings *settings, const dipole_info *info) {
  const uint64_t photons = (uint64_t)settings->photons.value;
  return !settings->photons.given && (settings->error.value > 0 || settings->total_error.value > 0)
             ? cli_limit(info, "max_mc_photons", photons)
             : photons;
}

/* The rings that --r is read from are so wide. Their bias is some 2e-3 of R where R falls by e
 * within a tenth of the radius, and less elsewhere. */
#define RING_WIDTH 0.03

/* Sets logarithmic rings, whose first and last lie around the smallest and largest radius. */
static void set_rings(const cli_numbers *r, dipole_mc_query *query) {
  double least_mm = r->items[0], most_mm = r->items[0];
  for (size_t i = 1; i < r->count; i++) {
    least_mm = fmin(least_mm, r->items[i]);
    most_mm = fmax(most_mm, r->items[i]);
  }
  const double steps = ceil(log(most_mm / least_mm) / RING_WIDTH);
  const double half = (steps > 0 ? log(most_mm / least_mm) / steps : RING_WIDTH) / 2;
  query->spacing = DIPOLE_LOGARITHMIC;
  query->ring_count = (uint32_t)steps + 1;
  query->radius_start_mm = least_mm * exp(-half);
  query->radius_stop_mm = most_mm * exp(half);
}

/* Makes the query of a channel. */
static void make_query(const cli_settings *settings, const cli_profile *profile, size_t channel,
                       report *of) {
  const bool measured = profile->medium != NULL;
  of->profile = profile;
  of->medium = measured && strchr(profile->medium, ',') == NULL ? profile->medium : NULL;
  of->channel = profile->names[channel];
  of->query = (dipole_mc_query){
      .layers = cli_profile_layers(profile, channel),
      .layer_count = profile->layer_count,
      .albedos = settings->albedo.items,
      .albedo_count = (unsigned)settings->albedo.count,
      .parameters = profile->parameters.items,
      .parameter_count = profile->parameters.count,
      .spacing = settings->log ? DIPOLE_LOGARITHMIC : DIPOLE_LINEAR,
      .ring_count = (uint32_t)settings->rings.value,
      .radius_start_mm = settings->from.value,
      .radius_stop_mm = settings->to.value,
      .seed = settings->seed.value,
      .photons = photons_of(settings, profile->info),
      .error_total = settings->total_error.value,
      .error_rings = settings->error.value,
  };
  of->r = &settings->r;
  if (of->r->count > 0) {
    set_rings(of->r, &of->query);
  }
}

/* ---- following the job ----------------------------------------------------------------------- */

static bool show_photons(void *context, const dipole_mc_progress *now) {
  cli_progress *progress = context;
  const double share = now->photons_expected > 0
                           ? (double)now->photons / (double)now->photons_expected
                           : (double)NAN;
  if (now->worst_to_mm > 0 && isfinite(now->error_rings)) {
    snprintf(progress->note, sizeof progress->note, "worst ring %.3g to %.3g mm%s: %.2g %%",
             now->worst_from_mm, now->worst_to_mm,
             now->worst_side == DIPOLE_MC_TRANSMITTED ? " (transmitted)" : "",
             100 * now->error_rings);
  }
  cli_progress_show(progress, share, (double)now->photons);
  return !cli_interrupted();
}

static bool run_job(dipole_client *client, const cli_settings *settings, report *of,
                    dipole_error *error) {
  const int64_t start_ms = cli_now_ms();
  cli_progress progress;
  bool good;
  cli_catch_interrupt();
  cli_progress_start(&progress, "photons");
  do {
    good = dipole_mc(client, &of->query, show_photons, &progress, &of->result, error);
  } while (!good && !cli_interrupted() && cli_try_again(settings, start_ms, error));
  cli_progress_wipe(&progress);
  return good;
}

/* ---- what was walked ------------------------------------------------------------------------- */

/* Reports of all channels whose jobs have ended, or of one. */
typedef struct reports {
  size_t count;
  report *items;
} reports;

/* Returns R or T at a radius, between the middles of the two rings beside it: in proportion to a
 * power of r where both have light, with its standard error. */
static dipole_mc_value value_at(const dipole_mc_result *result, uint32_t albedo, uint32_t side,
                                double r_mm) {
  const double *edges = result->edges_mm, *values = dipole_mc_values(result, albedo, side),
               *errors = dipole_mc_errors(result, albedo, side);
  const double width = log(edges[1] / edges[0]);
  const double place = fmin(fmax(log(r_mm / edges[0]) / width - 0.5, 0), result->ring_count - 1);
  const uint32_t low = (uint32_t)place;
  const uint32_t high = low + 1 < result->ring_count ? low + 1 : low;
  const double share = place - low, a = values[low], b = values[high];
  return (dipole_mc_value){a > 0 && b > 0 ? pow(a, 1 - share) * pow(b, share)
                                          : (1 - share) * a + share * b,
                           hypot((1 - share) * errors[low], share * errors[high])};
}

enum { PARTS_OF_SIDE = 4, PARTS_OF_ALL = 3, PARTS = 2 * PARTS_OF_SIDE + PARTS_OF_ALL };

/* Returns how many rows an albedo has: the radii of --r, or the rings and where the power went. */
static size_t rows_of(const report *of) {
  return of->r->count > 0
             ? of->r->count
             : of->result->side_count * (of->result->ring_count + PARTS_OF_SIDE) + PARTS_OF_ALL +
                   (of->query.layer_count > 1 ? of->query.layer_count : 0);
}

/* Writes a value and its error. A table has the error relative to it, too: "-" for no light. */
static void put_value(cli_rows *rows, const char *name, const char *error, const char *unit,
                      dipole_mc_value one) {
  char text[32];
  snprintf(text, sizeof text, one.value > 0 && isfinite(one.error) ? "%.2g %%" : "-",
           100 * one.error / one.value);
  cli_put_number(rows, one.value, name, NULL, unit, "%.5e", .below = "1/mm^2");
  cli_put_number(rows, one.error, error, NULL, unit, "%.1e", .below = "1/mm^2");
  cli_put_text(rows, text, "relative", .forms = CLI_IN_TABLE);
}

/* Writes R, and of a slab T, at a radius of --r. */
static void put_reading(cli_rows *rows, const report *of, uint32_t albedo, size_t index) {
  const double r_mm = of->r->items[index];
  cli_put_number(rows, r_mm, "r", .unit = "mm");
  put_value(rows, "R", "error", "1/mm^2", value_at(of->result, albedo, DIPOLE_MC_REFLECTED, r_mm));
  if (of->result->side_count > 1) {
    put_value(rows, "T", "T_error", "1/mm^2",
              value_at(of->result, albedo, DIPOLE_MC_TRANSMITTED, r_mm));
  }
}

/* Writes a ring of a side, or a part of the power, which has no radii and photons. */
static void put_quantity(cli_rows *rows, const report *of, uint32_t albedo, size_t index) {
  static const char *const sides[] = {"R", "T"};
  const dipole_mc_result *result = of->result;
  const dipole_mc_energy *energy = &result->energies[albedo];
  struct {
    const char *name;
    dipole_mc_value value;
  } parts[PARTS + CORE_LAYERS_MAX] = {
      {"R_total", energy->R},         {"R_unscattered", {energy->unscattered[0], 0}},
      {"R_under", energy->under[0]},  {"R_over", energy->over[0]},
      {"T_total", energy->T},         {"T_unscattered", {energy->unscattered[1], 0}},
      {"T_under", energy->under[1]},  {"T_over", energy->over[1]},
      {"absorbed", energy->absorbed}, {"unfinished", energy->unfinished},
      {"roulette", energy->roulette}};
  char absorbed[CORE_LAYERS_MAX][16];
  for (size_t i = 0; i < CORE_LAYERS_MAX; i++) {
    snprintf(absorbed[i], sizeof absorbed[i], "absorbed_%zu", i + 1);
    parts[PARTS + i].name = absorbed[i];
    parts[PARTS + i].value = energy->in_layer[i];
  }
  const size_t rings = (size_t)result->side_count * result->ring_count;
  const size_t part = index - rings, skipped = PARTS_OF_SIDE * (2 - (size_t)result->side_count);
  const bool is_ring = index < rings;
  const double none = (double)NAN;
  const size_t ring = index % result->ring_count;
  const uint32_t side = is_ring ? (uint32_t)(index / result->ring_count) : 0;
  const size_t at = is_ring ? 0 : part < PARTS_OF_SIDE * result->side_count ? part : part + skipped;
  const dipole_mc_value value = {dipole_mc_values(result, albedo, side)[ring],
                                 dipole_mc_errors(result, albedo, side)[ring]};
  cli_put_text(rows, is_ring ? sides[side] : parts[at].name, "quantity");
  cli_put_number(rows, is_ring ? result->edges_mm[ring] : none, "from", .unit = "mm",
                 .missing = "");
  cli_put_number(rows, is_ring ? result->edges_mm[ring + 1] : none, "to", .unit = "mm",
                 .missing = "");
  put_value(rows, "value", "error", NULL, is_ring ? value : parts[at].value);
  cli_put_number(rows, is_ring ? (double)dipole_mc_photons(result, side)[ring] : none, "photons",
                 .format = "%.0f", .missing = "");
}

/* Writes the medium of a channel and how its photons walked. */
static void put_walk(cli_rows *rows, const void *context) {
  const report *of = context;
  if (of->medium != NULL) {
    cli_put_text(rows, of->medium, "medium", "");
  }
  cli_put_text(rows, of->channel, "channel");
  cli_put_medium(rows, of->query.layers, of->query.layer_count);
  cli_put_parameters(rows, of->profile->info, &of->profile->parameters);
  cli_put_count(rows, of->query.seed, "seed", .forms = CLI_IN_TABLE | CLI_IN_JSON);
  cli_put_count(rows, of->result->last.photons, "photons", .forms = CLI_IN_TABLE);
}

/* Writes a row, by channels and albedos. A reading of --r is one that `dipole fit` reads. */
static void put_row(cli_rows *rows, const void *context, size_t index) {
  const reports *all = context;
  const size_t each = rows_of(&all->items[0]), albedos = all->items[0].result->albedo_count;
  const report *of = &all->items[index / (each * albedos)];
  const uint32_t albedo = (uint32_t)(index / each % albedos);
  const double value = of->result->energies[albedo].albedo;
  const bool readings = of->r->count > 0;
  char sample[80];
  snprintf(sample, sizeof sample, albedos > 1 ? "%s, albedo %.9g" : "%s", of->channel, value);
  if (readings) {
    cli_put_text(rows, sample, "sample");
  }
  if (rows->form != CLI_TABLE) { /* the titles of a table say it */
    put_walk(rows, of);
  }
  if (!readings) {
    cli_put_number(rows, value, "albedo");
  }
  (readings ? put_reading : put_quantity)(rows, of, albedo, index % each);
}

static void write_table(const void *context) {
  const reports *all = context;
  for (size_t i = 0; i < all->count; i++) {
    report *of = &all->items[i];
    cli_rows title = {.form = CLI_TABLE, .pass = CLI_ROWS_TITLE, .file = stdout, .between = ", "};
    fputs(i > 0 ? "\n" : "", stdout);
    put_walk(&title, of);
    puts(of->result->end == DIPOLE_MC_CANCELLED || of->result->end == DIPOLE_MC_STOPPED
             ? "\nCANCELLED: this is what had been walked by then\n"
             : "\n");
    cli_rows_print(stdout, 2, of->result->albedo_count * rows_of(of), put_row,
                   &(const reports){1, of});
    cli_write_launched(of->query.layers, 1, 1);
  }
  if (all->items[0].r->count == 0) {
    puts("under, over: within the first ring's inner edge, and beyond the last ring; unscattered: "
         "at\n"
         "r = 0; unfinished: walks that were cut off; roulette: added by it, about 0. These and "
         "the\n"
         "totals are shares of the power that entered.");
  }
}

/* Writes what holds for all channels. */
static void put_facts(cli_rows *rows, const void *context) {
  static const char *const ends[] = {[DIPOLE_MC_PHOTONS] = "photons",
                                     [DIPOLE_MC_ERRORS] = "errors",
                                     [DIPOLE_MC_CANCELLED] = "cancelled",
                                     [DIPOLE_MC_STOPPED] = "stopped"};
  const reports *all = context;
  const report *last = &all->items[all->count - 1];
  cli_put_text(rows, last->profile->info->software, "software", .forms = CLI_IN_JSON);
  cli_put_tissue(rows, last->profile);
  cli_put_text(rows, ends[last->result->end], "ended_by", "Monte Carlo, ended by");
  cli_put_count(rows, last->result->last.photons, "photons");
  cli_put_number(rows, last->result->last.error_total, "error_total", "error of the total R", NULL,
                 "%.2g");
  cli_put_number(rows, last->result->last.error_rings, "error_rings", "largest error of a ring",
                 NULL, "%.2g");
}

/* ---- the command ----------------------------------------------------------------------------- */

/* The table is written in any case; then reports whether it has less than was requested. */
static int judge(const report *of) {
  const unsigned long long photons = of->result->last.photons, requested = of->query.photons;
  if (of->result->end == DIPOLE_MC_CANCELLED) {
    return cli_fail("cancelled after %llu of %llu photons", photons, requested);
  }
  if (of->result->end == DIPOLE_MC_STOPPED) {
    return cli_fail("the daemon stopped after %llu of %llu photons: start the job again", photons,
                    requested);
  }
  if (of->result->end == DIPOLE_MC_PHOTONS &&
      (of->query.error_rings > 0 || of->query.error_total > 0)) {
    return cli_fail("%llu photons were too few for the requested error: the worst ring has "
                    "%.2g, R has %.2g: give more --photons",
                    photons, of->result->last.error_rings, of->result->last.error_total);
  }
  return CLI_OK;
}

/* Runs the job of each channel. Ctrl-C ends the present one, and none is begun after it. */
static int run_jobs(const cli_settings *settings, dipole_client *client, const cli_profile *profile,
                    reports *all) {
  dipole_error error;
  while (all->count < profile->channel_count && !cli_interrupted()) {
    report *of = &all->items[all->count];
    make_query(settings, profile, all->count, of);
    if (!run_job(client, settings, of, &error)) {
      return cli_fail_error(&error);
    }
    all->count++;
  }
  return CLI_OK;
}

static int run_mc(const cli_settings *settings, dipole_client *client) {
  cli_profile profile = {0};
  int status = cli_profile_take(settings, client, &profile);
  reports all = {.items = cli_allocate(profile.channel_count, sizeof *all.items)};
  status = status == CLI_OK ? run_jobs(settings, client, &profile, &all) : status;
  if (all.count > 0) {
    const cli_report output = {.facts = put_facts,
                               .rows = all.count * all.items[0].result->albedo_count *
                                       rows_of(&all.items[0]),
                               .put_row = put_row,
                               .table = write_table};
    cli_write(&output, settings->form, &all);
  }
  for (size_t i = 0; i < all.count; i++) {
    const int judged = judge(&all.items[i]);
    status = status != CLI_OK ? status : judged;
    dipole_mc_result_free(all.items[i].result);
  }
  return status;
}

const cli_command cli_command_mc = {
    .name = "mc",
    .about = "Walk photons through a medium (Monte Carlo): R(r) with standard errors",
    .more = "The daemon does this as jobs of low priority beside its other work, one a channel. "
            "Ctrl-C cancels the job and prints the result so far. Values are means over "
            "rings, in 1/mm^2 per unit of power that entered; below them stand shares of that "
            "power: the light beside the rings, the totals of R and T and what was absorbed. The "
            "exit status is 1 if the job was cancelled or missed the requested error.",
    .formats = "table,csv,json",
    .options = {cli_medium_options, cli_layer_options, options},
    .parameters = CLI_PARAMETER_BIT(PHASE) | CLI_PARAMETER_BIT(PHASE_SHARE) |
                  CLI_PARAMETER_BIT(PHASE_G) | CLI_PARAMETER_BIT(DETECTOR_NA) |
                  CLI_PARAMETER_BIT(ETA_BELOW),
    .examples = "  dipole mc --medium skin1\n"
                "  dipole mc --medium skin1 --channel blue --g 0.8 --error 0.02 --to 3\n"
                "  dipole mc --sigma-a 0.01 --sigma-s 10 --g 0.9 --eta 1.4 --thickness 2\n"
                "  dipole mc --layer 0.3,27,0.8,1.4,0.06 --layer 0.04,17,0.8,1.4 --to 3\n"
                "  dipole mc --sigma-a 0.1 --sigma-s 50 --g 0.8 --eta 1.4 --phase modified \\\n"
                "    --phase-share 0.889\n"
                "  dipole mc --sigma-a 0.1 --sigma-s 1 --albedo 0.5,0.9,0.99 --from 0.01 --log\n"
                "  dipole mc --medium skin1 --r 0.5,1,2,4 --format csv | dipole fit\n",
    .check = check,
    .run = run_mc,
};
