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
               "is then a "
               "file that `dipole fit` reads"),
    CLI_OPTION(NUMBER, from, NULL, "inner edge of the first ring, mm (default: 0)"),
    CLI_OPTION(NUMBER, to, "10", "outer edge of the last ring, mm"),
    CLI_OPTION(COUNT32, rings, "20", "how many rings there are"),
    CLI_OPTION(SWITCH, log, NULL,
               "make the ratios between edges equal instead of the steps; needs --from"),
    CLI_TITLE("Effort"),
    CLI_OPTION(
        NUMBER, photons, "1e6",
        "how many photons walk, such as 2e6 (with --error or --total-error, as many as the daemon "
        "allows)"),
    CLI_OPTION(NUMBER, error, NULL,
               "end when the relative standard error of each ring with light is so small"),
    CLI_OPTION(NUMBER, total_error, NULL,
               "end when that of the total R is so small; with --error, when both are"),
    CLI_OPTION(COUNT, seed, "1", "seed of the random numbers; the same seed gives the same bits"),
    {0},
};

typedef struct report {
  const dipole_info *info;
  const char *medium;        /* the only measured one; NULL if there is none */
  const char *channel;       /* the name of the channel */
  const cli_numbers *r;      /* none: rings are written */
  cli_parameters parameters; /* without the thickness */
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
    return cli_fail_usage("--r gives the radii one by one: leave --from, --to, --rings and --log "
                          "out");
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
  if (settings->albedo.count > UINT16_MAX) {
    return cli_fail_usage("--albedo: give at most %d", UINT16_MAX);
  }
  return CLI_OK;
}

/* ---- the query ------------------------------------------------------------------------------- */

/* Returns how many photons may walk. If an error is asked for, only the daemon limits them. */
static uint64_t photons_of(const cli_settings *settings, const dipole_info *info) {
  for (size_t i = 0; i < info->limit_count; i++) {
    if (!settings->photons.given && (settings->error.given || settings->total_error.given) &&
        strcmp(info->limits[i].name, "max_mc_photons") == 0) {
      return info->limits[i].value;
    }
  }
  return (uint64_t)settings->photons.value;
}

/* The rings that --r is read from are so wide. Their bias is some 2e-3 of R where R falls by e within
 * a tenth of the radius, and less elsewhere. */
#define RING_WIDTH 0.03

/* Sets the rings: logarithmic ones, of which the first and the last lie around the smallest and the
 * largest radius. */
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
  const cli_given *thickness = &settings->parameters[CORE_PARAMETER_THICKNESS];
  of->info = profile->info;
  of->medium = measured && strchr(profile->medium, ',') == NULL ? profile->medium : NULL;
  of->channel = profile->channels[channel].name;
  of->parameters = profile->parameters;
  cli_parameters_remove(&of->parameters, CORE_PARAMETER_THICKNESS); /* a field of its own */
  of->query = (dipole_mc_query){
      .medium = profile->media[channel],
      .albedos = settings->albedo.items,
      .albedo_count = (unsigned)settings->albedo.count,
      .thickness_mm = thickness->text != NULL ? thickness->value : (double)INFINITY,
      .parameters = of->parameters.items,
      .parameter_count = of->parameters.count,
      .spacing = settings->log ? DIPOLE_LOGARITHMIC : DIPOLE_LINEAR,
      .ring_count = (uint32_t)settings->rings.value,
      .radius_start_mm = settings->from.value,
      .radius_stop_mm = settings->to.value,
      .seed = settings->seed.value,
      .photons = photons_of(settings, of->info),
      .error_total = settings->total_error.value,
      .error_rings = settings->error.value,
  };
  of->r = &settings->r;
  if (of->r->count > 0) {
    set_rings(of->r, &of->query);
  }
}

/* ---- following the job ----------------------------------------------------------------------- */

static bool follow(void *context, const dipole_mc_progress *now) {
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
    good = dipole_mc(client, &of->query, follow, &progress, &of->result, error);
  } while (!good && !cli_interrupted() && cli_try_again(settings, start_ms, error));
  cli_progress_wipe(&progress);
  return good;
}

/* ---- what was walked ------------------------------------------------------------------------- */

/* The two sides of a slab. A half space has the first only. */
static const char *const sides[DIPOLE_MC_SIDES] = {"R", "T"};

/* A part of the power that entered. */
typedef struct part {
  const char *name;  /* for programs */
  const char *about; /* for people; parts of the one before are indented */
  dipole_mc_value value;
} part;

enum { PARTS_MAX = 11 };

/* Lists where the power went, and returns the number of parts. */
static size_t list_parts(const dipole_mc_result *result, size_t albedo, part parts[PARTS_MAX]) {
  const dipole_mc_energy *energy = &result->energies[albedo];
  const dipole_mc_value R0 = {energy->unscattered[0], 0}, T0 = {energy->unscattered[1], 0};
  const part either[][4] = {
      {{"R_total", "R, total", energy->R},
       {"R_unscattered", "  never scattered, at r = 0", R0},
       {"R_under", "  closer than the first ring", energy->under[0]},
       {"R_over", "  beyond the last ring", energy->over[0]}},
      {{"T_total", "T, total", energy->T},
       {"T_unscattered", "  never scattered, at r = 0", T0},
       {"T_under", "  closer than the first ring", energy->under[1]},
       {"T_over", "  beyond the last ring", energy->over[1]}},
  };
  const part rest[] = {{"absorbed", "absorbed", energy->absorbed},
                       {"unfinished", "unfinished walks", energy->unfinished},
                       {"roulette", "added by roulette", energy->roulette}};
  const size_t of_sides = 4 * (size_t)result->side_count;
  memcpy(parts, either, of_sides * sizeof *parts);
  memcpy(parts + of_sides, rest, sizeof rest);
  return of_sides + sizeof rest / sizeof rest[0];
}

/* A result, and which of its albedos is written. */
typedef struct one_albedo {
  const report *report;
  uint32_t albedo;
} one_albedo;

/* Returns R at a radius, between the middles of the two rings beside it: in proportion to a power of
 * r where both have light. *error: its standard error. */
static double R_at(const one_albedo *of, uint32_t side, double r_mm, double *error) {
  const dipole_mc_result *result = of->report->result;
  const double *edges = result->edges_mm, *R = dipole_mc_values(result, of->albedo, side),
               *errors = dipole_mc_errors(result, of->albedo, side);
  const double width = log(edges[1] / edges[0]);
  const double place = fmin(fmax(log(r_mm / edges[0]) / width - 0.5, 0), result->ring_count - 1);
  const uint32_t low = (uint32_t)place;
  const uint32_t high = low + 1 < result->ring_count ? low + 1 : low;
  const double share = place - low;
  *error = hypot((1 - share) * errors[low], share * errors[high]);
  return R[low] > 0 && R[high] > 0 ? pow(R[low], 1 - share) * pow(R[high], share)
                                   : (1 - share) * R[low] + share * R[high];
}

/* ---- for people ------------------------------------------------------------------------------ */

/* Puts R or T, its error, and that relative; "-" for no light, which has no relative error. */
static void put_value(cli_rows *rows, uint32_t side, double value, double error) {
  char text[32];
  snprintf(text, sizeof text, value > 0 && isfinite(error) ? "%.2g %%" : "-", 100 * error / value);
  cli_put_number(rows, CLI_COLUMN(sides[side], NULL, "1/mm^2", "%.5e"), value);
  cli_put_number(rows, CLI_COLUMN("standard error", NULL, "1/mm^2", "%.1e"), error);
  cli_put_text(rows, CLI_COLUMN("relative", .unit = " "), text);
}

/* Puts a ring, or one of the radii of --r. */
static void put_place(cli_rows *rows, const void *context, size_t index) {
  const one_albedo *of = context;
  const dipole_mc_result *result = of->report->result;
  const bool at_r = of->report->r->count > 0;
  if (at_r) {
    cli_put_number(rows, CLI_COLUMN("r", .unit = "mm"), of->report->r->items[index]);
  } else {
    cli_put_number(rows, CLI_COLUMN("from", .unit = "mm"), result->edges_mm[index]);
    cli_put_number(rows, CLI_COLUMN("to", .unit = "mm"), result->edges_mm[index + 1]);
  }
  for (uint32_t side = 0; side < result->side_count; side++) {
    double error = at_r ? 0 : dipole_mc_errors(result, of->albedo, side)[index];
    const double value = at_r ? R_at(of, side, of->report->r->items[index], &error)
                              : dipole_mc_values(result, of->albedo, side)[index];
    put_value(rows, side, value, error);
    if (!at_r) {
      cli_put_count(rows, CLI_COLUMN("photons", .unit = " "),
                    dipole_mc_photons(result, side)[index]);
    }
  }
}

static void put_part(cli_rows *rows, const void *context, size_t index) {
  const one_albedo *of = context;
  part parts[PARTS_MAX];
  list_parts(of->report->result, of->albedo, parts);
  cli_put_text(rows, CLI_COLUMN("per unit of power that entered"), parts[index].about);
  cli_put_number(rows, CLI_COLUMN("share"), parts[index].value.value);
  cli_put_number(rows, CLI_COLUMN("standard error", .format = "%.1e"), parts[index].value.error);
}

/* Puts the medium of a channel and how its photons walked. */
static void put_walk(cli_rows *rows, const void *context, size_t index) {
  const report *of = context;
  const dipole_mc_query *query = &of->query;
  (void)index;
  if (of->medium != NULL) {
    cli_put_text(rows, CLI_COLUMN("medium", ""), of->medium);
  }
  cli_put_text(rows, CLI_COLUMN("channel"), of->channel);
  cli_put_medium(rows, &query->medium);
  if (isfinite(query->thickness_mm)) { /* `dipole fit` refuses this column */
    cli_put_number(rows, CLI_COLUMN("thickness", .unit = "mm"), query->thickness_mm);
  }
  cli_put_parameters(rows, of->info, &of->parameters);
  cli_put_count(rows, CLI_COLUMN("seed", .forms = CLI_IN_TABLE | CLI_IN_JSON), query->seed);
  cli_put_count(rows, CLI_COLUMN("photons", .forms = CLI_IN_TABLE), of->result->last.photons);
}

/* All channels whose jobs have ended. */
typedef struct reports {
  size_t count;
  report *items;
} reports;

static void write_channel(const report *of) {
  part parts[PARTS_MAX];
  cli_rows title = {.form = CLI_TABLE, .pass = CLI_ROWS_TITLE, .file = stdout, .between = ", "};
  put_walk(&title, of, 0);
  puts(of->result->end == DIPOLE_MC_CANCELLED || of->result->end == DIPOLE_MC_STOPPED
           ? "\nCANCELLED: this is what had been walked by then"
           : "");
  for (uint32_t albedo = 0; albedo < of->result->albedo_count; albedo++) {
    const one_albedo one = {of, albedo};
    printf("\nsingle-scattering albedo %.6g\n\n", of->result->energies[albedo].albedo);
    cli_rows_print(stdout, 0, of->r->count > 0 ? of->r->count : of->result->ring_count, put_place,
                   &one);
    putchar('\n');
    cli_rows_print(stdout, 1, list_parts(of->result, albedo, parts), put_part, &one);
  }
  cli_write_launched(&of->query.medium, 1);
}

static void write_table(const void *context) {
  const reports *all = context;
  for (size_t i = 0; i < all->count; i++) {
    fputs(i > 0 ? "\n" : "", stdout);
    write_channel(&all->items[i]);
  }
}

/* ---- for programs: channel by channel, albedo by albedo, the rings and then where power went -- */

/* Returns how many rows an albedo has. */
static size_t rows_of(const reports *all) {
  const report *of = &all->items[0];
  part parts[PARTS_MAX];
  return of->r->count > 0 ? of->r->count
                          : (size_t)of->result->side_count * of->result->ring_count +
                                list_parts(of->result, 0, parts);
}

/* Puts a reading of --r, which `dipole fit` reads. */
static void put_reading(cli_rows *rows, const one_albedo *of, size_t index) {
  const report *from = of->report;
  char albedo[DECIMAL_BYTES], sample[80];
  double error;
  const bool several = from->result->albedo_count > 1;
  const double value = R_at(of, 0, from->r->items[index], &error);
  decimal_write(from->result->energies[of->albedo].albedo, albedo);
  snprintf(sample, sizeof sample, "%s%s%s", from->channel, several ? ", albedo " : "",
           several ? albedo : "");
  cli_put_text(rows, CLI_COLUMN("sample"), sample);
  put_walk(rows, from, 0);
  cli_put_number(rows, CLI_COLUMN("r", .unit = "mm"), from->r->items[index]);
  cli_put_number(rows, CLI_COLUMN("R", .unit = "1/mm^2"), value);
  cli_put_number(rows, CLI_COLUMN("error", .unit = "1/mm^2"), error);
}

/* Puts a ring of a side, or a part of the power, which has no radii and photons. */
static void put_quantity(cli_rows *rows, const one_albedo *of, size_t index) {
  const dipole_mc_result *result = of->report->result;
  const size_t ring_rows = (size_t)result->side_count * result->ring_count;
  const bool is_ring = index < ring_rows;
  const uint32_t side = is_ring ? (uint32_t)(index / result->ring_count) : 0;
  const size_t ring = is_ring ? index % result->ring_count : 0;
  part parts[PARTS_MAX];
  list_parts(result, of->albedo, parts);
  const part ring_part = {sides[side],
                          NULL,
                          {dipole_mc_values(result, of->albedo, side)[ring],
                           dipole_mc_errors(result, of->albedo, side)[ring]}};
  const part *one = is_ring ? &ring_part : &parts[index - ring_rows];
  const double none = (double)NAN;
  put_walk(rows, of->report, 0);
  cli_put_number(rows, CLI_COLUMN("albedo"), result->energies[of->albedo].albedo);
  cli_put_text(rows, CLI_COLUMN("quantity"), one->name);
  cli_put_number(rows, CLI_COLUMN("from", .unit = "mm"), is_ring ? result->edges_mm[ring] : none);
  cli_put_number(rows, CLI_COLUMN("to", .unit = "mm"), is_ring ? result->edges_mm[ring + 1] : none);
  cli_put_number(rows, CLI_COLUMN("value", .unit = "of rings 1/mm^2, of others 1"),
                 one->value.value);
  cli_put_number(rows, CLI_COLUMN("error"), one->value.error);
  cli_put_number(rows, CLI_COLUMN("photons"),
                 is_ring ? (double)dipole_mc_photons(result, side)[ring] : none);
}

static void put_row(cli_rows *rows, const void *context, size_t index) {
  const reports *all = context;
  const size_t each = rows_of(all), albedos = all->items[0].result->albedo_count;
  const one_albedo one = {&all->items[index / (each * albedos)],
                          (uint32_t)(index / each % albedos)};
  (one.report->r->count > 0 ? put_reading : put_quantity)(rows, &one, index % each);
}

/* Puts what holds for all channels. */
static void put_facts(cli_rows *rows, const void *context, size_t index) {
  static const char *const ends[] = {[DIPOLE_MC_PHOTONS] = "photons",
                                     [DIPOLE_MC_ERRORS] = "errors",
                                     [DIPOLE_MC_CANCELLED] = "cancelled",
                                     [DIPOLE_MC_STOPPED] = "stopped"};
  const reports *all = context;
  const report *last = &all->items[all->count - 1];
  (void)index;
  cli_put_text(rows, CLI_COLUMN("software", .forms = CLI_IN_JSON), last->info->software);
  cli_put_text(rows, CLI_COLUMN("ended_by", "Monte Carlo, ended by"), ends[last->result->end]);
  cli_put_count(rows, CLI_COLUMN("photons"), last->result->last.photons);
  cli_put_number(rows, CLI_COLUMN("error_total", "error of the total R"),
                 last->result->last.error_total);
  cli_put_number(rows, CLI_COLUMN("error_rings", "largest error of a ring"),
                 last->result->last.error_rings);
}

/* ---- the command ----------------------------------------------------------------------------- */

/* The table is written in any case; then the user is told if it is less than what was asked for. */
static int judge(const report *of) {
  const unsigned long long photons = of->result->last.photons, asked = of->query.photons;
  if (of->result->end == DIPOLE_MC_CANCELLED) {
    return cli_fail("cancelled after %llu of %llu photons", photons, asked);
  }
  if (of->result->end == DIPOLE_MC_STOPPED) {
    return cli_fail("the daemon stopped after %llu of %llu photons: start the job again", photons,
                    asked);
  }
  if (of->result->end == DIPOLE_MC_PHOTONS &&
      (of->query.error_rings > 0 || of->query.error_total > 0)) {
    return cli_fail("%llu photons were not enough for the error asked for: the worst ring has "
                    "%.2g, R has %.2g: ask for more --photons",
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

static int run(const cli_settings *settings, dipole_client *client) {
  cli_profile profile = {0};
  int status = cli_profile_take(settings, client, &profile);
  reports all = {.items = cli_allocate(profile.channel_count, sizeof *all.items)};
  status = status == CLI_OK ? run_jobs(settings, client, &profile, &all) : status;
  if (all.count > 0) {
    const cli_report output = {.facts = put_facts,
                               .rows =
                                   all.count * all.items[0].result->albedo_count * rows_of(&all),
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
    .more =
        "\n"
        "The daemon does this as jobs of low priority beside its other work, one a channel.\n"
        "Ctrl-C cancels the job and prints what has been walked by then. Values are means over\n"
        "rings, in 1/mm^2 per unit of power that entered. A second table has the light beyond the\n"
        "rings, the totals of R and T and what was absorbed. The exit status is 1 if the job was\n"
        "cancelled or missed the error that was asked for.\n",
    .formats = "table,csv,json",
    .options = {cli_medium_options, options},
    .parameters = CLI_PARAMETER_BIT(PHASE) | CLI_PARAMETER_BIT(PHASE_SHARE) |
                  CLI_PARAMETER_BIT(PHASE_G) | CLI_PARAMETER_BIT(DETECTOR_NA) |
                  CLI_PARAMETER_BIT(THICKNESS),
    .examples = "  dipole mc --medium skin1\n"
                "  dipole mc --medium skin1 --channel blue --g 0.8 --error 0.02 --to 3\n"
                "  dipole mc --sigma-a 0.01 --sigma-s 10 --g 0.9 --eta 1.4 --thickness 2\n"
                "  dipole mc --sigma-a 0.1 --sigma-s 50 --g 0.8 --eta 1.4 --phase modified \\\n"
                "    --phase-share 0.889\n"
                "  dipole mc --sigma-a 0.1 --sigma-s 1 --albedo 0.5,0.9,0.99 --from 0.01 --log\n"
                "  dipole mc --medium skin1 --r 0.5,1,2,4 --format csv | dipole fit\n",
    .check = check,
    .run = run,
};
