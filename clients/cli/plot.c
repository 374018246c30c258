/* dipole plot: pictures of profiles over r, and of how far they are from radiative transport. */
#include "clients/cli/eval.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/options.h"
#include "clients/cli/picture.h"
#include "core/gauss.h"

#define REFERENCE CLI_MODEL_DEFAULT
#define RINGS_DEFAULT 24 /* number of rings with --mc and without --count */
#define FROM_SHARE 1e-3  /* on a logarithmic axis, --from is this share of --to by default */
#define PERCENT_MAX 200  /* deviations beyond this are not drawn */

enum { RINGS_MAX = 4096, FEW_MODELS = 4 };

static const cli_option options[] = {
    CLI_TITLE("Radii"),
    CLI_OPTION(NUMBERS, r, NULL, "these radii, mm"),
    CLI_EVAL_F_OPTION,
    CLI_OPTION(NUMBER, from, NULL,
               "the first radius, mm (default: 0; on a logarithmic axis --to / 1000)"),
    CLI_OPTION(NUMBER, to, "10", "the last radius, mm"),
    CLI_OPTION(COUNT, count, "401",
               "how many radii a curve has; with --mc, how many rings (then 24)"),
    CLI_OPTION(SWITCH, log, NULL,
               "make the ratios between radii equal instead of the steps (default: if r is on a "
               "logarithmic axis and --from is above 0)"),
    CLI_TITLE("Picture"),
    CLI_OPTION(TEXT, quantity, "R",
               "what to draw: R, cdf, pdf, dR_dr, ln_R, 2_pi_r_R, S or, over spatial frequencies, "
               "R_f; see `dipole info`"),
    CLI_OPTION(TEXT, axes, "logarithmic",
               "linear; semilog: values are logarithmic; logarithmic: r is, too"),
    {"error", "add a panel with the relative deviation from " REFERENCE, CLI_SWITCH,
     offsetof(cli_settings, deviation), NULL, NULL},
    {"mc",
     "walk so many photons in each channel, such as 1e6, and draw means over rings: of Monte Carlo "
     "with standard errors, and of the models",
     CLI_NUMBER, offsetof(cli_settings, photons), NULL, "PHOTONS"},
    CLI_OPTION(FILES, plot, NULL,
               "draw into FILE.svg or FILE.png; -: as text on standard output. May be repeated "
               "(default: -)"),
    {0},
};

/* ---- the command line ------------------------------------------------------------------------ */

/* Sets the defaults in which `dipole plot` differs from `dipole eval`. */
static void set_defaults(cli_settings *settings) {
  if (settings->photons.given && !settings->count.given) {
    settings->count.value = RINGS_DEFAULT;
  }
  if (settings->r.count == 0 && settings->f.count == 0 &&
      strcmp(settings->axes, "logarithmic") == 0) {
    if (!settings->from.given && settings->to.value > 0 && isfinite(settings->to.value)) {
      settings->from = (cli_number){true, FROM_SHARE * settings->to.value};
    }
    settings->log = settings->log || settings->from.value > 0;
  }
}

static int check_walk(const cli_settings *settings) {
  const double photons = settings->photons.value;
  if (!(photons >= 1 && photons <= 0x1p53 && photons == floor(photons))) {
    return cli_fail_usage("--mc: give a whole number of photons from 1 to 9e15, such as 1e6");
  }
  if (settings->r.count > 0 || settings->f.count > 0 || strcmp(settings->quantity, "R") != 0) {
    return cli_fail_usage("--mc draws means of R over rings: give --from, --to and --count in "
                          "place of --r, --f and --quantity");
  }
  if (settings->count.value < 1 || settings->count.value > RINGS_MAX ||
      !(settings->from.value >= 0 && settings->to.value > settings->from.value &&
        isfinite(settings->to.value))) {
    return cli_fail_usage(
        "--mc: give 1 to %d rings, from --from, 0 or more, to --to, which is larger", RINGS_MAX);
  }
  return CLI_OK;
}

static int check(cli_settings *settings) {
  set_defaults(settings);
  const int status = cli_eval_check(settings);
  if (status != CLI_OK) {
    return status;
  }
  if (strcmp(settings->axes, "linear") != 0 && strcmp(settings->axes, "semilog") != 0 &&
      strcmp(settings->axes, "logarithmic") != 0) {
    return cli_fail_usage("--axes: '%s' is unknown; they are linear, semilog and logarithmic",
                          settings->axes);
  }
  if (settings->deviation && settings->thickness.count > 0) {
    return cli_fail_usage("--error compares with " REFERENCE
                          ", which has no slabs: leave --thickness out");
  }
  return settings->photons.given ? check_walk(settings) : CLI_OK;
}

/* ---- curves ---------------------------------------------------------------------------------- */

/* Adds the curve of a model and channel. Few models have a dash each and channels a colour; else
 * models have a colour and channels a dash. model: beyond the report's, that of Monte Carlo */
static cli_curve *add_curve(cli_picture *picture, const cli_eval_report *report, size_t model,
                            size_t channel) {
  const cli_profile *profile = &report->profile;
  const bool by_colour = profile->channel_count > 1 && report->model_count <= FEW_MODELS;
  const size_t colour = cli_colour(profile->names[channel]);
  const char *name = model < report->model_count ? report->models[model].choice->name : "mc";
  cli_curve *curve = cli_picture_add(picture);
  curve->colour = (unsigned)(!by_colour             ? model
                             : colour < CLI_COLOURS ? CLI_COLOUR_RED + colour
                                                    : channel);
  curve->dash = (unsigned)(by_colour ? model : channel);
  curve->count = report->place_count;
  curve->x = report->places;
  if (profile->channel_count > 1) {
    snprintf(curve->title, sizeof curve->title, "%s, %s%s", name,
             profile->medium != NULL || profile->tissue != NULL ? "" : "channel ",
             profile->names[channel]);
  } else {
    snprintf(curve->title, sizeof curve->title, "%s", name);
  }
  return curve;
}

/* Names what the picture is of: measured media, or else the coefficients of the first channel. */
static void write_title(const cli_profile *profile, char *text, size_t bytes) {
  const dipole_medium *medium = &profile->media[0];
  if (profile->medium != NULL) {
    snprintf(text, bytes, "%s", profile->medium);
  } else if (profile->tissue != NULL) {
    snprintf(text, bytes, "%s, haemoglobin by %s", profile->tissue, profile->haemoglobin->name);
  } else if (profile->layer_count > 1) {
    snprintf(text, bytes, "%u layers", profile->layer_count);
  } else {
    snprintf(text, bytes, "sigma_a %.6g/mm, sigma_s %.6g/mm, g %.6g, eta %.6g%s",
             medium->sigma_a_per_mm, medium->sigma_s_per_mm, medium->g, medium->eta,
             profile->channel_count > 1 ? " and others" : "");
  }
}

static void set_labels(cli_picture *picture, const cli_eval_report *report,
                       const dipole_choice *quantity) {
  write_title(&report->profile, picture->title, sizeof picture->title);
  picture->x_label = report->place[0] == 'f' ? "f (1/mm)" : "r (mm)";
  snprintf(picture->y_label, sizeof picture->y_label, "%s (%s)", quantity->name,
           quantity->id == DIPOLE_R ? report->profile.info->R_unit : quantity->about);
}

/* Returns whether the ratios between radii are equal. */
static bool has_equal_ratios(const cli_eval_report *report) {
  const double *r = report->places;
  const size_t n = report->place_count;
  return n > 2 && r[0] > 0 && isfinite(r[n - 1]) && r[n - 1] > r[0] &&
         fabs(r[1] / r[0] / (r[n - 1] / r[n - 2]) - 1) < 1e-3;
}

int cli_plot_R(const cli_eval_report *report, const cli_texts *paths) {
  cli_picture picture = {.logarithmic_x = has_equal_ratios(report), .logarithmic_y = true};
  const size_t channels = report->profile.channel_count;
  size_t quantity = 0;
  while (report->quantities.items[quantity]->id != DIPOLE_R) {
    quantity++;
  }
  set_labels(&picture, report, report->quantities.items[quantity]);
  for (size_t k = 0; k < report->model_count * channels; k++) {
    add_curve(&picture, report, k / channels, k % channels)->y = report->values[k].arrays[quantity];
  }
  return cli_picture_draw(&picture, paths);
}

/* ---- means over rings, and Monte Carlo ------------------------------------------------------- */

/* Nodes of a ring, which lie the closer the nearer to its inner edge, as R falls by orders of
 * magnitude within a ring. */
enum { NODES = 2 * CORE_GAUSS_HALF };

typedef struct rings {
  size_t count;
  double *edges_mm; /* [count + 1] */
  /* [count * NODES] nodes and weights of integrals over r, ring by ring */
  double *nodes_mm, *weights_mm;
  double *R, *R_error; /* [channel_count][count] by Monte Carlo */
} rings;

static rings make_rings(const cli_settings *settings) {
  const double from_mm = settings->from.value, to_mm = settings->to.value;
  rings of = {.count = (size_t)settings->count.value};
  of.edges_mm = cli_allocate(of.count + 1, sizeof(double));
  of.nodes_mm = cli_allocate(of.count * NODES, sizeof(double));
  of.weights_mm = cli_allocate(of.count * NODES, sizeof(double));
  for (size_t i = 0; i < of.count; i++) {
    const double share = (double)i / (double)of.count;
    of.edges_mm[i] =
        settings->log ? from_mm * pow(to_mm / from_mm, share) : from_mm + (to_mm - from_mm) * share;
  }
  of.edges_mm[of.count] = to_mm;
  for (size_t i = 0; i < of.count * NODES; i++) {
    const double *edges_mm = of.edges_mm + i / NODES, width_mm = edges_mm[1] - edges_mm[0];
    const double node = core_gauss_node((int)(i % NODES));
    of.nodes_mm[i] = edges_mm[0] + width_mm * node * node;
    of.weights_mm[i] = width_mm * 2 * node * core_gauss_weight((int)(i % NODES));
  }
  return of;
}

/* Turns a report of 2 pi r R at the nodes, its only quantity, into one of R over the rings, whose
 * places are the radii that halve the rings' areas. */
static void take_means(const rings *of, cli_eval_report *report) {
  const double pi = acos(-1), *edges_mm = of->edges_mm;
  for (size_t k = 0; k < report->model_count * report->profile.channel_count; k++) {
    double **values = &report->values[k].arrays[0];
    double *means = cli_allocate(of->count, sizeof *means);
    for (size_t i = 0; i < of->count * NODES; i++) {
      means[i / NODES] += of->weights_mm[i] * (*values)[i];
    }
    for (size_t i = 0; i < of->count; i++) {
      means[i] /= pi * (edges_mm[i + 1] * edges_mm[i + 1] - edges_mm[i] * edges_mm[i]);
    }
    *values = means;
  }
  report->place_count = of->count;
  for (size_t i = 0; i < of->count; i++) {
    report->places[i] = hypot(edges_mm[i], edges_mm[i + 1]) / sqrt(2);
  }
}

static bool show_photons(void *context, const dipole_mc_progress *now) {
  const double expected = (double)now->photons_expected, done = (double)now->photons;
  cli_progress_show(context, done / fmax(expected, done), done);
  return true;
}

/* Walks photons through the medium of each channel: a half space, or a slab of --thickness. */
static int walk(const cli_settings *settings, dipole_client *client, const cli_profile *profile,
                rings *of) {
  dipole_error error;
  bool good = true;
  of->R = cli_allocate(profile->channel_count * of->count, sizeof(double));
  of->R_error = cli_allocate(profile->channel_count * of->count, sizeof(double));
  for (size_t i = 0; good && i < profile->channel_count; i++) {
    const dipole_mc_query query = {.layers = cli_profile_layers(profile, i),
                                   .layer_count = profile->layer_count,
                                   .spacing = settings->log ? DIPOLE_LOGARITHMIC : DIPOLE_LINEAR,
                                   .ring_count = (uint32_t)of->count,
                                   .radius_start_mm = of->edges_mm[0],
                                   .radius_stop_mm = of->edges_mm[of->count],
                                   .seed = 1,
                                   .photons = (uint64_t)settings->photons.value};
    dipole_mc_result *result = NULL;
    cli_progress progress;
    cli_progress_start(&progress, "photons");
    good = dipole_mc(client, &query, show_photons, &progress, &result, &error);
    cli_progress_wipe(&progress);
    for (size_t k = 0; good && k < of->count; k++) {
      of->R[i * of->count + k] = dipole_mc_values(result, 0, DIPOLE_MC_REFLECTED)[k];
      of->R_error[i * of->count + k] = dipole_mc_errors(result, 0, DIPOLE_MC_REFLECTED)[k];
    }
    dipole_mc_result_free(result);
  }
  return good ? CLI_OK : cli_fail_error(&error);
}

/* ---- the deviation from transport ------------------------------------------------------------ */

/* Returns the position of the reference model, and names the channels for which it is not radiative
 * transport itself; report->model_count if there is nothing to compare with. */
static size_t find_reference(const cli_eval_report *report) {
  const size_t channels = report->profile.channel_count;
  size_t at = report->model_count, held = 0;
  while (at-- > 0 && strcmp(report->models[at].choice->name, REFERENCE) != 0) {
  }
  for (size_t i = 0; at < report->model_count && i < channels; i++) {
    const bool holds = report->values[at * channels + i].errors.model_error == 0;
    held += holds;
    if (!holds) {
      cli_fail("--error: no deviation is shown of %s, because " REFERENCE
               " is not known to hold for its g, eta and absorption",
               report->profile.names[i]);
    }
  }
  return held > 0 ? at : report->model_count;
}

/* Sets the curve's part of the lower panel, in percent. values: [2][count] to be kept */
static void set_deviation(cli_curve *curve, const cli_eval_values *reference, double *values) {
  const double *from = reference->arrays[0];
  for (size_t i = 0; i < curve->count; i++) {
    const bool good = isfinite(curve->y[i]) && isfinite(from[i]) && from[i] != 0;
    values[i] = good ? 100 * (curve->y[i] / from[i] - 1) : (double)NAN;
    values[curve->count + i] = good && curve->error != NULL ? 100 * curve->error[i] / from[i] : 0;
  }
  curve->lower = values;
  curve->lower_error = values + curve->count;
}

/* ---- the command ----------------------------------------------------------------------------- */

/* Returns whether a model was requested to compare with it, and not by --model. */
static bool is_unlisted(const cli_settings *settings, const cli_eval_report *report, size_t model) {
  return model < report->model_count && !report->models[model].named &&
         strcmp(report->models[model].choice->name, REFERENCE) == 0 &&
         !cli_texts_have(&settings->model, "all");
}

/* Draws the models of the report, and Monte Carlo. */
static int draw_plot(const cli_settings *settings, const cli_eval_report *report, const rings *of) {
  static char text[] = "-";
  char *texts[] = {text};
  const cli_texts onto_terminal = {1, texts, text}, *files = &settings->plot;
  const size_t channels = report->profile.channel_count, count = report->place_count;
  const size_t reference = settings->deviation ? find_reference(report) : 0;
  cli_picture picture = {.logarithmic_x = strcmp(settings->axes, "logarithmic") == 0,
                         .logarithmic_y = strcmp(settings->axes, "linear") != 0};
  if (reference == report->model_count) {
    return cli_fail("--error: there is nothing to compare with: leave --error out");
  }
  set_labels(&picture, report,
             of != NULL ? cli_choice_of_id(report->profile.info, DIPOLE_QUANTITY, DIPOLE_R)
                        : report->quantities.items[0]);
  picture.lower_label = settings->deviation ? "deviation from " REFERENCE " (%)" : NULL;
  picture.lower_most = PERCENT_MAX;
  double *deviations =
      cli_allocate((report->model_count + 1) * channels * count, 2 * sizeof *deviations);
  const size_t models = report->model_count + (of != NULL);
  for (size_t k = 0; k < models * channels; k++) {
    const size_t model = k / channels, i = k % channels;
    if (is_unlisted(settings, report, model)) {
      continue;
    }
    cli_curve *curve = add_curve(&picture, report, model, i);
    curve->y = model < report->model_count ? report->values[k].arrays[0] : of->R + i * count;
    curve->error = model < report->model_count ? NULL : of->R_error + i * count;
    const cli_eval_values *from = &report->values[reference * channels + i];
    if (settings->deviation && from->errors.model_error == 0) {
      set_deviation(curve, from, deviations + 2 * k * count);
    }
  }
  return cli_picture_draw(&picture, files->count > 0 ? files : &onto_terminal);
}

/* Requests one quantity at the radii of `eval`, which has to have a value at each. */
static int request_curves(cli_settings eval, const char *name, dipole_client *client,
                          cli_eval_report *report) {
  char *wanted[] = {cli_copy(name, strlen(name))};
  eval.wanted = (cli_texts){1, wanted, wanted[0]};
  const dipole_choice *choice =
      cli_named(dipole_get_info(client), DIPOLE_QUANTITY, "quantity", name);
  if (choice != NULL && (choice->id & (CLI_OF_CHANNEL | DIPOLE_RADIUS)) != 0) {
    return cli_fail_usage("--quantity %s: there is no curve of it over r; name another quantity",
                          name);
  }
  return choice != NULL ? cli_eval_request(&eval, client, report) : CLI_USAGE;
}

static int run_plot(const cli_settings *settings, dipole_client *client) {
  const bool walks = settings->photons.given;
  cli_settings eval = *settings;
  cli_eval_report report = {0};
  rings of = walks ? make_rings(&eval) : (rings){0};
  if (walks) {
    eval.r = (cli_numbers){.count = of.count * NODES, .items = of.nodes_mm};
  }
  int status = request_curves(eval, walks ? "2_pi_r_R" : settings->quantity, client, &report);
  if (status == CLI_OK && walks) {
    take_means(&of, &report);
    status = walk(settings, client, &report.profile, &of);
  }
  if (status == CLI_OK) {
    status = draw_plot(settings, &report, walks ? &of : NULL);
  }
  return status;
}

const cli_command cli_command_plot = {
    .name = "plot",
    .about = "Draw profiles over r, and how far they are from radiative transport",
    .more = "Up to four models have a dash each and channels a colour; with more, or with a single "
            "channel, models have a colour each. On a logarithmic axis, values below 1e-12 of the "
            "largest are left out, and deviations beyond 200 %. `dipole eval` writes the numbers.\n"
            "With --mc, a value is the mean over a ring, and stands at the radius that halves the "
            "ring's area. Monte Carlo is drawn as points with their standard errors.\n"
            "gnuplot draws all pictures. Text has colours only on a terminal, unless NO_COLOR is "
            "set.",
    .formats = "none",
    .options = {cli_medium_options, cli_layer_options, cli_eval_options, options},
    .parameters = CLI_OF_MODELS,
    .examples =
        "  dipole plot --medium skin1 --model classical,better,transport\n"
        "  dipole plot --medium skin1 --channel red --model all --error --plot skin1.svg\n"
        "  dipole plot --medium marble,wholemilk --channel green --model better,transport\n"
        "  dipole plot --sigma-a 0.01,0.1,1 --sigma-s 1 --eta 1.4 --quantity 2_pi_r_R \\\n"
        "    --axes linear --to 20 --plot a.png --plot a.svg\n"
        "  dipole plot --medium skin1 --channel red --model better,transport --mc 1e5 --error\n",
    .check = check,
    .run = run_plot,
};
