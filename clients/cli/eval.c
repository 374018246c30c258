/* dipole eval: profiles of a medium over a range of radii; dipole sample: drawn radii. Requests them from a
 * daemon model by model, puts the replies together, and writes them. */
#include "clients/cli/eval.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/options.h"
#include "clients/cli/picture.h"
#include "clients/cli/progress.h"
#include "proto/schema.h"

#define MODEL_ALL "all"

static const cli_option radii_options[] = {
    CLI_OPTION(FILE, mci, NULL,
               "read an input file of MCML, version 1.0, and write what MCML would estimate from "
               "infinitely many photons, without a daemon: R and T by rings of its dr, totals, and "
               "what each layer absorbs, per power that was launched, in cm. --tolerance holds "
               "(default: 1e-3)"),
    CLI_TITLE("Radii"),
    CLI_OPTION(NUMBERS, r, NULL, "these radii, mm; one may be inf"),
    CLI_EVAL_F_OPTION,
    CLI_OPTION(NUMBER, from, "0", "the first radius of a grid, mm; of R_f a frequency, 1/mm"),
    CLI_OPTION(NUMBER, to, "10", "the last radius of the grid, or frequency"),
    CLI_OPTION(COUNT, count, "21", "how many radii the grid has"),
    CLI_OPTION(SWITCH, log, NULL,
               "make the ratios between radii equal instead of the steps; needs --from"),
    {0},
};

const cli_option cli_eval_options[] = {
    CLI_TITLE("Evaluation"),
    CLI_OPTION(NAMES, model, NULL,
               "`dipole info` lists them; all: every model that accepts the query, with all its "
               "parameters, while standard error names those that refuse it (default: transport; "
               "with --tolerance the cheapest that keeps it)"),
    CLI_MOMENTS_OPTION,
    CLI_EVALUATOR_OPTION,
    CLI_DEADLINE_OPTION,
    {0},
};

static const cli_option output_options[] = {
    CLI_OPTION(
        NAMES, wanted, NULL,
        "what to evaluate. R: 1/mm^2 per unit of power that entered; albedo; cdf: the share of the "
        "albedo within r; S: 1/(mm^2 sr); R_f: for striped light, at spatial frequencies in 1/mm; "
        "balance: where the power goes, and what each layer absorbs; `dipole info` lists all "
        "(default: R,albedo; with --f R_f,albedo)"),
    CLI_OPTION(SWITCH, errors, NULL,
               "also write model_errors: how far the model is from transport at each radius. A "
               "medium for which transport has no stored solution is solved, which takes seconds"),
    CLI_TITLE("Output"),
    CLI_OPTION(FILES, plot, NULL,
               "also draw R over r into FILE.svg or FILE.png; -: as text below the table. May be "
               "repeated. `dipole plot` draws more"),
    {0},
};

/* ---- what replies hold ----------------------------------------------------------------------- */

/* Adds a model, or notes that it is named if it is there already. Returns what the report has of
 * it, until the next call. */
static cli_eval_model *add_model(cli_eval_report *report, const dipole_choice *model, bool named) {
  for (size_t i = 0; i < report->model_count; i++) {
    if (report->models[i].choice == model) {
      report->models[i].named |= named;
      return &report->models[i];
    }
  }
  report->models = cli_resize(report->models, report->model_count + 1, sizeof *report->models);
  report->models[report->model_count] = (cli_eval_model){.choice = model, .named = named};
  return &report->models[report->model_count++];
}

/* Allocates the values of all models and channels. Their arrays are NULL. */
static void make_values(cli_eval_report *report) {
  report->values =
      cli_allocate(report->model_count * report->profile.channel_count, sizeof *report->values);
}

/* Keeps the errors of a part: the largest model error of all parts. */
static void keep_errors(dipole_errors *kept, dipole_errors part, bool is_first) {
  const double before = kept->model_error;
  *kept = part;
  kept->model_error = is_first ? part.model_error : cli_larger(before, part.model_error);
}

/* Keeps the part of a reply that begins at place `first` of the model at a position, of the channels from
 * `channel` on. A list that is requested in pieces has the errors of all. */
static void keep_part(cli_eval_report *report, size_t model, size_t of_channel, size_t first,
                      const dipole_result *part) {
  for (uint32_t i = 0; i < part->channel_count; i++) {
    const dipole_channel *channel = &part->channels[i];
    cli_eval_values *values =
        &report->values[model * report->profile.channel_count + of_channel + i];
    values->albedo = channel->albedo;
    if (channel->balance != NULL) {
      values->balance = *channel->balance;
    }
    const dipole_errors all = {channel->numerical_error, channel->numerical_error_per_mm,
                               channel->model_error};
    keep_errors(&values->errors, all, first == 0);
    for (size_t q = 0; q < report->quantities.count; q++) {
      const unsigned id = report->quantities.items[q]->id;
      keep_errors(&values->of_each[q], dipole_errors_of(part, i, id), first == 0);
      if ((id & CLI_OF_CHANNEL) != 0) {
        continue;
      }
      /* allocated now, because the daemon accepts this many places */
      if (values->arrays[q] == NULL) {
        values->arrays[q] = cli_allocate(report->place_count, sizeof(double));
      }
      for (size_t k = 0; k < part->radius_count; k++) {
        values->arrays[q][first + k] = cli_value(part, i, id, k);
      }
    }
  }
  report->models[model].notes |= part->notes;
}

/* ---- models ---------------------------------------------------------------------------------- */

static bool choose_model(const char *name, bool is_reference, cli_eval_report *report) {
  const dipole_choice *model = cli_named(report->profile.info, DIPOLE_MODEL, "model", name);
  if (model != NULL) {
    add_model(report, model, !is_reference)->is_reference |= is_reference;
  }
  return model != NULL;
}

static bool choose_models(const cli_settings *settings, cli_eval_report *report) {
  const cli_texts *names = &settings->model;
  if (names->count == 0 && settings->parameters[CORE_PARAMETER_TOLERANCE].text != NULL) {
    add_model(report, NULL, true); /* NULL: the daemon chooses the model */
    return true;
  }
  for (size_t i = 0; i < names->count; i++) {
    const dipole_choice *model;
    if (strcmp(names->items[i], MODEL_ALL) != 0) {
      if (!choose_model(names->items[i], false, report)) {
        return false;
      }
      continue;
    }
    for (size_t from = 0;
         (model = cli_next_choice(report->profile.info, DIPOLE_MODEL, &from)) != NULL;) {
      add_model(report, model, false);
    }
  }
  return names->count > 0 || choose_model(CLI_MODEL_DEFAULT, false, report);
}

/* ---- quantities and radii -------------------------------------------------------------------- */

/* Looks up the quantities, R and the albedo by default, and sets where values are. Says what is
 * wrong and returns false if that fails. */
static bool take_quantities(const cli_settings *settings, cli_eval_report *report) {
  const bool at_f = settings->f.count > 0;
  const unsigned usual = DIPOLE_ALBEDO | (at_f ? DIPOLE_TRANSFER : DIPOLE_R);
  if (!cli_quantities_take(report->profile.info, &settings->wanted, usual, DIPOLE_RADIUS,
                           &report->quantities)) {
    return false;
  }
  if (settings->errors && (report->quantities.wanted & DIPOLE_MODEL_ERRORS) == 0) {
    report->quantities.wanted |= DIPOLE_MODEL_ERRORS;
    report->quantities.items[report->quantities.count++] =
        cli_choice_of_id(report->profile.info, DIPOLE_QUANTITY, DIPOLE_MODEL_ERRORS);
  }
  const bool by_f = core_is_at_frequencies(report->quantities.wanted);
  report->place = by_f ? "f" : "r";
  if ((at_f || (report->quantities.wanted & CORE_AT_FREQUENCIES) != 0) &&
      (!by_f || settings->r.count > 0)) {
    return cli_fails_usage(
        "what ends with _f is at the spatial frequencies of --f, all else at the "
        "radii of --r: request one of both");
  }
  return true;
}

/* Sets the radii of a query to those that are requested, in single or double precision; to none if
 * no quantity has a value for each radius. */
static void set_radii(const cli_settings *settings, const cli_eval_report *report, bool single,
                      dipole_query *query) {
  const cli_numbers *list = settings->f.count > 0 ? &settings->f : &settings->r;
  query->spacing = DIPOLE_LIST;
  if ((report->quantities.wanted & ~(CLI_OF_CHANNEL | DIPOLE_RADIUS)) == 0) {
    return;
  }
  if (list->count > 0) {
    query->radius_count = list->count;
    query->radii = cli_numbers_in(list, single);
    return;
  }
  query->spacing = settings->log ? DIPOLE_LOGARITHMIC : DIPOLE_LINEAR;
  query->radius_count = settings->count.value;
  query->radius_start_mm = settings->from.value;
  query->radius_stop_mm = settings->to.value;
}

/* ---- requests ---------------------------------------------------------------------------------- */

typedef struct requests {
  const cli_settings *settings;
  dipole_client *client;
  cli_eval_report *report;
  unsigned bad_value; /* id of the status bad-value */
  size_t model;       /* index of the model that is requested */
  size_t done, total; /* models */
  size_t channel;     /* first of those that are requested */
  dipole_query query;
  cli_progress progress;
} requests;

/* Keeps a part of the reply, and the daemon's choice of model and evaluator if no model was named:
 * returns false if it does not list them. */
static bool receive(void *context, const dipole_result *part, uint64_t first) {
  requests *run = context;
  cli_eval_report *report = run->report;
  cli_eval_model *model = &report->models[run->model];
  const bool is_grid = run->query.spacing != DIPOLE_LIST;
  if (model->choice == NULL) {
    const dipole_info *info = report->profile.info;
    model->choice = cli_choice_of_id(info, DIPOLE_MODEL, part->model);
    model->evaluator = cli_choice_of_id(info, DIPOLE_EVALUATOR, part->evaluator);
    if (model->choice == NULL || model->evaluator == NULL) {
      return false;
    }
  }
  if (report->places == NULL) {
    report->place_count = (size_t)run->query.radius_count;
    report->places = cli_allocate(report->place_count, sizeof *report->places);
  }
  for (size_t i = 0; i < part->radius_count; i++) {
    const double r =
        part->radius_f64 != NULL ? part->radius_f64[i] : cli_number_of_single(part->radius_f32[i]);
    report->places[first + i] = is_grid ? cli_number_rounded(r) : r;
  }
  keep_part(report, run->model, run->channel, (size_t)first, part);
  if (report->place_count > 0) {
    const double of_model = (double)(report->place_count * report->profile.channel_count);
    const double done = (double)run->done * of_model +
                        (double)(run->channel * report->place_count) +
                        (double)((first + part->radius_count) * part->channel_count);
    cli_progress_show(&run->progress, done / ((double)run->total * of_model), done);
  }
  return true;
}

/* Requests the model, of many wavelengths piece by piece. It has to take the parameters, unless it is
 * there only as the reference. Where the daemon chooses the model, and no evaluator is named, single
 * precision is taken, which is cheaper, unless only double precision keeps the tolerance. */
static bool request_model(requests *run, dipole_error *error) {
  const cli_eval_report *report = run->report;
  const dipole_info *info = report->profile.info;
  cli_eval_model *model = &run->report->models[run->model];
  cli_parameters parameters = report->profile.parameters;
  const bool is_any = model->choice == NULL;
  const size_t channels = report->profile.channel_count;
  /* a choice of the daemon is one of all channels */
  const size_t most = report->profile.wavelengths_nm != NULL && !is_any
                          ? (size_t)cli_limit(info, "max_media", 1)
                          : channels;
  for (run->channel = 0;;) {
    run->query =
        (dipole_query){.model = is_any ? DIPOLE_ANY_MODEL : model->choice->id,
                       .evaluator = model->evaluator->id,
                       .moments = report->profile.moments->id,
                       .wanted = report->quantities.wanted | DIPOLE_RADIUS | DIPOLE_MODEL_ERROR,
                       CLI_MEDIA_OF(&report->profile),
                       .parameters = parameters.items,
                       .parameter_count = parameters.count,
                       CLI_DEADLINE_OF(run->settings)};
    const size_t left = channels - run->channel;
    run->query.media = cli_profile_layers(&report->profile, run->channel);
    run->query.medium_count = (uint32_t)(left < most ? left : most);
    set_radii(run->settings, report, model->evaluator->id != DIPOLE_F64, &run->query);
    if (CLI_RETRY(run->settings, error,
                  dipole_eval_parts(run->client, &run->query, receive, run, error))) {
      run->channel += run->query.medium_count;
      if (run->channel == channels) {
        return true;
      }
      continue;
    }
    const dipole_choice *refused = cli_choice(info, DIPOLE_PARAMETER, error->field);
    if (is_any && error->kind == DIPOLE_ERROR_REFUSED && strcmp(error->field, "tolerance") == 0 &&
        run->settings->evaluator == NULL && model->evaluator->id != DIPOLE_F64) {
      model->evaluator = cli_choice_of_id(info, DIPOLE_EVALUATOR, DIPOLE_F64);
    } else if (!model->is_reference || model->named || error->kind != DIPOLE_ERROR_REFUSED ||
               error->status != run->bad_value || refused == NULL ||
               strncmp(error->allowed, "nothing", strlen("nothing")) != 0 ||
               !cli_parameters_remove(&parameters, refused->id)) {
      return false; /* "nothing": the model does not take the parameter, whatever its value */
    }
  }
}

/* A model that `--model all` leaves out, and why. */
typedef struct left_out {
  const char *model;
  dipole_error error;
} left_out;

/* Writes one line for each model that is left out. If every model is, the query is probably wrong:
 * then each reason is given once. */
static int report_left_out(const left_out *models, size_t count, bool all) {
  for (size_t i = 0; i < count; i++) {
    char what[96];
    bool reported = false;
    for (size_t k = 0; k < i; k++) {
      reported = reported || strcmp(models[k].error.text, models[i].error.text) == 0;
    }
    snprintf(what, sizeof what, "%s is left out: ", models[i].model);
    if (!all || !reported) {
      cli_fail_error_of(all ? "" : what, &models[i].error);
    }
  }
  return all ? CLI_FAILED : CLI_OK;
}

/* Reports why a model cannot evaluate the query. Names it if another model could, as with a parameter that
 * this one needs or does not take. model: NULL if the daemon was to choose it. */
static int fail_model(const requests *run, const dipole_choice *model, const dipole_error *error) {
  char what[96] = "";
  if (model != NULL && error->kind == DIPOLE_ERROR_REFUSED && error->status == run->bad_value &&
      (cli_choice(run->report->profile.info, DIPOLE_PARAMETER, error->field) != NULL ||
       cli_in_list("thickness,wanted", error->field))) {
    snprintf(what, sizeof what, "model %s: ", model->name);
  }
  return cli_fail_error_of(what, error);
}

/* Sends a request for each model. Those that reply move up in the report to fill the gaps. */
static int request_all(requests *run) {
  cli_eval_report *report = run->report;
  left_out *out = cli_allocate(run->total, sizeof *out);
  size_t out_count = 0;
  int status = CLI_OK;
  for (; status == CLI_OK && run->done < run->total; run->done++) {
    dipole_error error;
    cli_eval_model *requested = &report->models[run->model];
    *requested = report->models[run->done];
    if (request_model(run, &error)) {
      run->model++;
    } else if (!requested->named && error.kind == DIPOLE_ERROR_REFUSED &&
               error.status == run->bad_value) {
      out[out_count++] = (left_out){requested->choice->name, error};
    } else {
      cli_progress_wipe(&run->progress);
      status = error.kind == DIPOLE_ERROR_STOPPED
                   ? cli_fail("the daemon chose a model or evaluator that it does not list")
                   : fail_model(run, requested->choice, &error);
    }
  }
  cli_progress_wipe(&run->progress);
  report->model_count = run->model;
  return status == CLI_OK ? report_left_out(out, out_count, run->model == 0) : status;
}

int cli_eval_request(const cli_settings *settings, dipole_client *client, cli_eval_report *report) {
  const int status = cli_profile_take(settings, client, &report->profile);
  if (status != CLI_OK) {
    return status;
  }
  const dipole_info *info = report->profile.info;
  if (!choose_models(settings, report) ||
      (settings->deviation && !choose_model(CLI_MODEL_DEFAULT, true, report)) ||
      !take_quantities(settings, report)) {
    return CLI_USAGE;
  }
  report->chosen = report->models[0].choice == NULL;
  for (size_t i = 0; i < report->model_count; i++) {
    cli_eval_model *model = &report->models[i];
    const char *name = model->choice != NULL ? model->choice->name : NULL;
    model->evaluator =
        report->profile.evaluator != NULL
            ? report->profile.evaluator
            : cli_choice(info, DIPOLE_EVALUATOR, cli_usual_evaluator(settings, name));
  }
  report->profile.evaluator = NULL; /* the table's own evaluator is in each row */
  make_values(report);
  requests run = {.settings = settings,
                  .client = client,
                  .report = report,
                  .total = report->model_count,
                  .bad_value = dipole_id(client, DIPOLE_STATUS, "bad-value")};
  cli_progress_start(&run.progress, "values");
  return request_all(&run);
}

/* ---- errors ---------------------------------------------------------------------------------- */

/* Returns the unit of the places: mm, 1/mm or 1. */
static const char *unit_of_places(const cli_eval_report *report) {
  return report->place[0] == 'r' ? "mm" : report->place[0] == 'f' ? "1/mm" : "1";
}

/* Returns the radius at which the error of value `at` is stated: its place, or the radius that was
 * drawn for it (NaN if radii are not wanted). */
static double radius_at(const cli_eval_report *report, const cli_eval_values *values, size_t at) {
  size_t q = 0;
  if (report->draw == NULL) {
    return report->place_count > 0 ? report->places[at] : 0;
  }
  while (q < report->quantities.count && report->quantities.items[q]->id != DIPOLE_RADIUS) {
    q++;
  }
  return q < report->quantities.count ? values->arrays[q][at] : (double)NAN;
}

/* Finds the smallest and largest finite place. Sets `diverges` if rows at r = 0 state a model error
 * of a quantity that diverges there. */
static void survey(cli_eval_report *report) {
  const unsigned diverging = DIPOLE_R | DIPOLE_S | DIPOLE_SLOPE | DIPOLE_LN_R;
  bool compared = false, any = false;
  for (size_t i = 0; i < report->place_count; i++) {
    const double place = report->places[i];
    if (isfinite(place)) {
      report->least = any ? fmin(report->least, place) : place;
      report->most = any ? fmax(report->most, place) : place;
      any = true;
    }
  }
  for (size_t i = 0; i < report->model_count * report->profile.channel_count; i++) {
    compared = compared || report->values[i].errors.model_error != 0;
  }
  report->diverges = any && report->least == 0 && report->draw == NULL && compared &&
                     (report->quantities.wanted & diverging) != 0;
}

/* ---- rows ------------------------------------------------------------------------------------ */

/* Writes the errors of a quantity, or of all if `of` is "", at r_mm. */
static void put_errors_of(cli_rows *rows, const cli_eval_report *report,
                          const dipole_errors *errors, double r_mm, unsigned forms,
                          const char *of) {
  char numerical[64], model[64];
  const char *none = report->diverges && !(report->most > 0) ? "diverges" : "not solved";
  snprintf(numerical, sizeof numerical, "numerical_error%s%s", of[0] != '\0' ? "_" : "", of);
  snprintf(model, sizeof model, "model_error%s%s", of[0] != '\0' ? "_" : "", of);
  cli_put_number(rows, cli_numerical_error(errors, r_mm), numerical, "numerical error",
                 .format = "%.1e", .over = of, .forms = forms);
  cli_put_number(rows, errors->model_error, model, "model error", NULL, "%.1e", none, .over = of,
                 .forms = forms);
}

/* Writes the errors of a model and channel; in a table those of all radii, else those at r_mm. Those
 * of each quantity follow if there are several, and stand alone in a table. */
static void put_errors(cli_rows *rows, const cli_eval_report *report, const cli_eval_values *values,
                       double r_mm) {
  const cli_quantities *quantities = &report->quantities;
  const unsigned beside = DIPOLE_RADIUS | DIPOLE_MODEL_ERRORS;
  const bool several = __builtin_popcount(quantities->wanted & ~beside) > 1;
  put_errors_of(rows, report, &values->errors, r_mm, several ? CLI_IN_CSV | CLI_IN_JSON : 0, "");
  for (size_t q = 0; several && q < quantities->count; q++) {
    if ((quantities->items[q]->id & (DIPOLE_RADIUS | DIPOLE_MODEL_ERRORS)) == 0) {
      put_errors_of(rows, report, &values->of_each[q], r_mm, 0, quantities->items[q]->name);
    }
  }
}

/* Writes the facts with which every report of values begins. */
static void put_facts(cli_rows *rows, const void *context) {
  const cli_eval_report *report = context;
  cli_put_profile(rows, &report->profile);
  if (report->draw != NULL) {
    cli_put_text(rows, report->draw->name, "draw");
    cli_put_count(rows, report->seed, "seed");
    cli_put_count(rows, report->first, "first");
  } else if (report->place[0] == 'f') {
    cli_put_text(rows, "R_f, the reflectance of striped light", "R_f", "");
  } else {
    cli_put_text(rows, report->profile.info->R_unit, "R", "R in");
  }
}

/* Returns the rows of a model and channel: one for each place, or one for the albedo alone. */
static size_t rows_of_channel(const cli_eval_report *report) {
  return report->place_count > 0 ? report->place_count : 1;
}

/* Writes where the power goes, which the structure's last numbers say of the layers. */
static void put_balance(cli_rows *rows, const dipole_balance *of, uint32_t layers) {
  const schema_field *names = schema_structures[SCHEMA_STRUCTURE_balance].fields;
  for (size_t i = 0; i < 4 + layers; i++) {
    cli_put_number(rows, ((const double *)of)[i], names[i].name);
  }
}

/* Writes the values of a model and channel at a place; in a table, what holds for all places. */
static void put_value(cli_rows *rows, const void *context, size_t index) {
  const cli_eval_report *report = context;
  const bool each = rows->form != CLI_TABLE;
  const size_t at = each ? index % rows_of_channel(report) : 0;
  const size_t profile = each ? index / rows_of_channel(report) : index;
  const cli_eval_model *model = &report->models[profile / report->profile.channel_count];
  const cli_eval_values *values = &report->values[profile];
  const size_t channel = profile % report->profile.channel_count;
  if (report->profile.wavelengths_nm != NULL) {
    cli_put_number(rows, report->profile.wavelengths_nm[channel], "wavelength_nm", "wavelength",
                   "nm");
  }
  cli_put_text(rows, model->choice->name, "model");
  if (report->profile.wavelengths_nm == NULL) {
    cli_put_text(rows, report->profile.names[channel], "channel");
  }
  cli_put_medium(rows, cli_profile_layers(&report->profile, channel), report->profile.layer_count);
  if (each && report->place_count > 0) {
    cli_put_number(rows, report->places[at], report->place, .unit = unit_of_places(report));
  }
  for (size_t q = 0; q < report->quantities.count; q++) {
    const dipole_choice *quantity = report->quantities.items[q];
    const bool is_albedo = quantity->id == DIPOLE_ALBEDO;
    if (quantity->id == DIPOLE_BALANCE) {
      put_balance(rows, &values->balance, report->profile.layer_count);
    } else if (each || is_albedo) {
      cli_put_number(rows, is_albedo ? values->albedo : values->arrays[q][at], quantity->name,
                     .unit = quantity->about);
    }
  }
  put_errors(rows, report, values,
             each                   ? radius_at(report, values, at)
             : report->draw == NULL ? report->most
                                    : 0);
  cli_put_text(rows, model->evaluator->name, "evaluator");
  cli_put_notes(rows, report->profile.info, model->notes);
}

/* ---- tables for people ----------------------------------------------------------------------- */

/* Models that are in adjacent columns of one table. */
typedef struct block {
  const cli_eval_report *report;
  size_t first, count; /* of models */
} block;

enum { BLOCK_COLUMNS = 12 };

/* Whether lines of a table are wavelengths, and columns places; else it is the other way round. */
static bool lists_wavelengths(const cli_eval_report *report) {
  return report->profile.wavelengths_nm != NULL && report->draw == NULL &&
         report->profile.channel_count >= report->place_count;
}

static size_t lines_of(const cli_eval_report *report, bool columns) {
  return lists_wavelengths(report) != columns ? report->profile.channel_count : report->place_count;
}

/* Returns the models from `first` on that fit into a readable table. */
static block block_from(const cli_eval_report *report, size_t first) {
  const size_t columns = report->quantities.count * lines_of(report, true);
  const size_t count = columns < BLOCK_COLUMNS ? BLOCK_COLUMNS / columns : 1;
  const size_t left = report->model_count - first;
  return (block){report, first, left < count ? left : count};
}

/* Writes a place or wavelength, and the values of all quantities, models and channels or places. */
static void put_line(cli_rows *rows, const void *context, size_t index) {
  const block *of = context;
  const cli_eval_report *report = of->report;
  const size_t channels = report->profile.channel_count, each = lines_of(report, true);
  const double *wavelengths_nm = lists_wavelengths(report) ? report->profile.wavelengths_nm : NULL;
  if (wavelengths_nm != NULL) {
    cli_put_number(rows, wavelengths_nm[index], "wavelength", .unit = "nm");
  } else {
    cli_put_number(rows, report->places[index], report->place, .unit = unit_of_places(report));
  }
  for (size_t k = 0; k < report->quantities.count * of->count * each; k++) {
    const size_t q = k / (of->count * each), model = of->first + k / each % of->count;
    const size_t channel = wavelengths_nm != NULL ? index : k % each;
    const size_t place = wavelengths_nm != NULL ? k % each : index;
    const dipole_choice *quantity = report->quantities.items[q];
    const double *array = report->values[model * channels + channel].arrays[q];
    char head[128];
    if (wavelengths_nm != NULL) {
      snprintf(head, sizeof head, "%s %.6g %s", quantity->name, report->places[place],
               unit_of_places(report));
    } else {
      snprintf(head, sizeof head, "%s %s", quantity->name, report->profile.names[channel]);
    }
    if (array != NULL) {
      cli_put_number(rows, array[place], head, .unit = quantity->about,
                     .format = strncmp(quantity->about, "1/", 2) == 0 ? "%.4e" : "%.6g",
                     .over = report->models[model].choice->name);
    }
  }
}

static void write_table(const void *context) {
  const cli_eval_report *report = context;
  const cli_profile *profile = &report->profile;
  for (size_t first = 0; report->place_count > 0 && first < report->model_count;) {
    const block models = block_from(report, first);
    cli_rows_print(stdout, 0, lines_of(report, false), put_line, &models);
    putchar('\n');
    first += models.count;
  }
  cli_rows_print(stdout, profile->wavelengths_nm != NULL ? 0 : 2,
                 report->model_count * profile->channel_count, put_value, report);
  fputs("numerical error: at most, against the model's formula", stdout);
  if (report->draw == NULL && report->most > 0) {
    printf(", at %s = ", report->place);
    if (report->least < report->most) {
      printf("%.6g to ", report->least);
    }
    printf("%.6g %s", report->most, unit_of_places(report));
  }
  printf("\nmodel error: the largest, of the model against radiative transport%s\n",
         report->diverges ? ", at r > 0: transport diverges at r = 0" : "");
  puts("errors are relative, but of ln R, its derivatives, paths and modulated light absolute, as "
       "the\n"
       "cdf's model error is, and of R_f over the albedo");
  cli_write_launched(profile->media, profile->channel_count, profile->layer_count);
  unsigned notes = 0;
  for (size_t i = 0; i < report->model_count; i++) {
    notes |= report->models[i].notes;
  }
  cli_write_notes(profile->info, notes);
  if (report->chosen) {
    printf("took %s (%s), the cheapest that keeps the tolerance\n", report->models[0].choice->name,
           report->models[0].evaluator->name);
  }
}

static void write_report(const cli_eval_report *report, enum cli_form form) {
  const cli_report output = {.facts = put_facts,
                             .rows = report->model_count * report->profile.channel_count *
                                     rows_of_channel(report),
                             .put_row = put_value,
                             .table = write_table};
  cli_eval_report surveyed = *report;
  survey(&surveyed);
  cli_write(&output, form, &surveyed);
}

/* ---- the command ----------------------------------------------------------------------------- */

int cli_eval_check(cli_settings *settings) {
  const bool at_f = settings->f.count > 0;
  if (settings->mci != NULL) {
    return settings->not_for_mci == NULL
               ? CLI_OK
               : cli_fail_usage("--mci evaluates what its file says: leave --%s out",
                                settings->not_for_mci);
  }
  const int status = cli_medium_check(settings);
  if (status != CLI_OK) {
    return status;
  }
  if ((at_f || settings->r.count > 0) &&
      (settings->from.given || settings->to.given || settings->count.given || settings->log)) {
    return cli_fail_usage("--%s gives the %s one by one: leave --from, --to, --count and --log out",
                          at_f ? "f" : "r", at_f ? "frequencies" : "radii");
  }
  if (settings->log && !settings->from.given) {
    return cli_fail_usage("--log needs --from, above 0");
  }
  return cli_picture_check(&settings->plot, settings);
}

static bool is_local(const cli_settings *settings) {
  return settings->mci != NULL;
}

static int run_eval(const cli_settings *settings, dipole_client *client) {
  cli_eval_report report = {0};
  if (settings->mci != NULL) {
    return cli_mci(settings);
  }
  const int status = cli_eval_request(settings, client, &report);
  if (status != CLI_OK) {
    return status;
  }
  if (settings->plot.count > 0 && (report.quantities.wanted & DIPOLE_R) == 0) {
    return cli_fail_usage("--plot draws R: add R to --wanted");
  }
  write_report(&report, settings->form);
  return settings->plot.count > 0 ? cli_plot_R(&report, &settings->plot) : CLI_OK;
}

const cli_command cli_command_eval = {
    .name = "eval",
    .about = "Evaluate a medium over a range of radii, as a table or a picture",
    .more =
        "The output has the values, their numerical error, the model's own error at these radii "
        "(against radiative transport, where that is solved), and notes on what the model does not "
        "do. A value is within the sum of both errors of transport. Some models are infinite at r "
        "= 0: tables and CSV then say inf, JSON \"inf\". NaN is an empty cell or null.\n"
        "With --tolerance and without --model, the daemon takes transport in the cheapest "
        "evaluator that keeps the tolerance for all channels and radii; the time to prepare a "
        "medium counts, so that few radii may get another one than many. With --model, --tolerance "
        "is a bound on the numerical error; where transport is solved, the error may "
        "exceed it, and says so." CLI_DEFAULT_TEXT,
    .formats = "table,csv,json",
    .options = {cli_medium_options, cli_layer_options, radii_options, cli_eval_options,
                output_options},
    .parameters = CLI_OF_MODELS,
    .examples = "  dipole eval --medium skin1 --model classical,better --plot skin1.svg\n"
                "  dipole eval --sigma-a 0.01,0.1 --sigma-s 10 --g 0.9 --eta 1.4 --r 0,0.5,1,2\n"
                "  dipole eval --medium marble --from 0.01 --to 100 --count 41 --log --format csv\n"
                "  dipole eval --medium skin2 --eta 1 --moments fit --wanted albedo\n"
                "  dipole eval --medium skin1 --wanted S --cos-in 0.8 --cos-out 0.5 --r 0.5,1,2\n"
                "  dipole eval --medium skin1 --tolerance 0.01\n"
                "  dipole eval --sigma-a 0.05 --sigma-s 9.5 --g 0.9 --eta 1.4 --tolerance 0.01\n"
                "  dipole eval --medium skin1 --model better --evaluator f32 --wanted R,cdf\n"
                "  dipole eval --medium skin1 --model all --plot all.svg\n"
                "  dipole eval --mci sample.mci --tolerance 0.01\n",
    .check = cli_eval_check,
    .is_local = is_local,
    .run = run_eval,
};

/* ---- dipole sample: radii in proportion to the light that leaves there ----------------------- */

#define DRAW_OF_A_LIST "list"

static const cli_option sample_options[] = {
    CLI_TITLE("Numbers"),
    CLI_OPTION(NUMBERS, u, NULL,
               "take these numbers, from 0 (which gives 0 mm) to 1 (which gives inf)"),
    CLI_OPTION(COUNT, count, "10", "how many numbers are drawn"),
    CLI_OPTION(TEXT, draw, NULL,
               "how to draw them. random; stratified: one in each of N equal intervals; regular: "
               "the middles of the intervals (default: random)"),
    CLI_OPTION(COUNT, seed, "1", "for random and stratified; the same seed gives the same bits"),
    CLI_OPTION(COUNT, first, NULL, "for random: start with number N of the seed (default: 0)"),
    CLI_TITLE("Evaluation"),
    CLI_OPTION(NAME, model, CLI_MODEL_DEFAULT, "a model that covers all radii; see `dipole info`"),
    CLI_MOMENTS_OPTION,
    CLI_EVALUATOR_OPTION,
    CLI_OPTION(
        NAMES, wanted, NULL,
        "what to write. r: the radii; pdf: their density, 1/mm, which is 2 pi r times that of "
        "points on the surface; `dipole info` lists all, at these radii (default: r,pdf)"),
    CLI_DEADLINE_OPTION,
    {0},
};

static int sample_check(cli_settings *settings) {
  if (settings->u.count > 0 && (settings->count.given || settings->draw != NULL ||
                                settings->seed.given || settings->first.given)) {
    return cli_fail_usage(
        "--u gives the numbers one by one: leave --count, --draw, --seed and --first out");
  }
  if (settings->evaluator == NULL) {
    settings->evaluator = cli_usual_evaluator(settings, settings->model.items[0]);
  }
  return cli_medium_check(settings);
}

/* Looks up the names of the draw and the quantities. */
static int sample_choose(const cli_settings *settings, cli_eval_report *report) {
  const char *draw = settings->draw != NULL ? settings->draw : "random";
  report->place = "u";
  report->draw = cli_named(report->profile.info, DIPOLE_DRAW, "draw",
                           settings->u.count > 0 ? DRAW_OF_A_LIST : draw);
  if (report->draw == NULL) {
    return CLI_USAGE;
  }
  if (settings->u.count == 0 && report->draw->id == DIPOLE_DRAW_LIST) {
    return cli_fail_usage("--draw %s: give the numbers with --u", DRAW_OF_A_LIST);
  }
  return cli_quantities_take(report->profile.info, &settings->wanted, DIPOLE_RADIUS | DIPOLE_PDF, 0,
                             &report->quantities)
             ? CLI_OK
             : CLI_USAGE;
}

static dipole_sample_query make_sample_query(const cli_settings *settings,
                                             const cli_eval_report *report) {
  const cli_profile *profile = &report->profile;
  const unsigned draw = report->draw->id;
  const bool seeded = draw == DIPOLE_DRAW_RANDOM || draw == DIPOLE_DRAW_STRATIFIED;
  return (dipole_sample_query){
      .model = profile->model->id,
      .evaluator = profile->evaluator->id,
      .wanted = report->quantities.wanted | DIPOLE_MODEL_ERROR,
      CLI_MEDIA_OF(profile),
      .draw = draw,
      .sample_count = settings->u.count > 0 ? settings->u.count : settings->count.value,
      .sample_first = settings->first.value,
      /* A seed that has no use is sent if it was given, so that the daemon refuses it. */
      .seed = seeded || settings->seed.given ? settings->seed.value : 0,
      CLI_QUERY_OF(profile),
      CLI_DEADLINE_OF(settings),
  };
}

/* Random numbers are requested in pieces of this size, to show progress. */
enum { PIECE_SAMPLES = 1 << 16 };

static bool request_pieces(const cli_settings *settings, dipole_client *client,
                           const dipole_sample_query *query, cli_eval_report *report,
                           dipole_error *error) {
  const uint64_t count = query->sample_count;
  const bool cut = query->draw == DIPOLE_DRAW_RANDOM && count > PIECE_SAMPLES;
  cli_progress progress;
  uint64_t first = 0;
  bool good;
  cli_progress_start(&progress, "radii");
  do {
    dipole_sample_query piece = *query;
    dipole_result *result;
    piece.sample_first += first;
    piece.sample_count = cut && count - first > PIECE_SAMPLES ? PIECE_SAMPLES : count - first;
    good = CLI_RETRY(settings, error, dipole_sample(client, &piece, &result, error));
    if (good) {
      report->place_count = (size_t)count;
      keep_part(report, 0, 0, (size_t)first, result);
      dipole_result_free(result);
    }
    first += piece.sample_count;
    cli_progress_show(&progress, (double)first / (double)count, (double)first);
  } while (good && first < count);
  cli_progress_wipe(&progress);
  return good;
}

static int request_samples(const cli_settings *settings, dipole_client *client,
                           cli_eval_report *report) {
  const bool single = report->profile.evaluator->id != DIPOLE_F64;
  dipole_sample_query query = make_sample_query(settings, report);
  dipole_error error;
  report->seed = query.seed;
  report->first = query.sample_first;
  query.numbers = settings->u.count > 0 ? cli_numbers_in(&settings->u, single) : NULL;
  if (!request_pieces(settings, client, &query, report, &error)) {
    return cli_fail_error(&error);
  }
  const void *u = query.numbers;
  if (u == NULL) {
    void *drawn = cli_allocate(report->place_count, sizeof(double));
    if (!dipole_sample_numbers(&query, 0, report->place_count, drawn, &error)) {
      return cli_fail_error(&error);
    }
    u = drawn;
  }
  report->places = cli_allocate(report->place_count, sizeof *report->places);
  for (size_t i = 0; i < report->place_count; i++) {
    report->places[i] =
        single ? cli_number_of_single(((const float *)u)[i]) : ((const double *)u)[i];
  }
  return CLI_OK;
}

static int sample_run(const cli_settings *settings, dipole_client *client) {
  cli_eval_report report = {0};
  int status = cli_profile_take(settings, client, &report.profile);
  status = status == CLI_OK ? sample_choose(settings, &report) : status;
  if (status == CLI_OK) {
    add_model(&report, report.profile.model, true);
    report.models[0].evaluator = report.profile.evaluator;
    make_values(&report);
    status = request_samples(settings, client, &report);
  }
  if (status == CLI_OK) {
    write_report(&report, settings->form);
  }
  return status;
}

const cli_command cli_command_sample = {
    .name = "sample",
    .about = "Draw radii in proportion to the light that leaves there",
    .more = "Each number u gives the radius within which the share u of the light leaves. So "
            "uniform numbers give radii in proportion to r R(r). All channels get the same "
            "numbers." CLI_DEFAULT_TEXT,
    .formats = "table,csv,json",
    .options = {cli_medium_options, cli_layer_options, sample_options},
    .parameters = CLI_OF_MODELS,
    .check = sample_check,
    .run = sample_run,
    .examples = "  dipole sample --medium skin1\n"
                "  dipole sample --medium skin1 --u 0.1,0.5,0.9 --wanted r,pdf,R,cdf\n"
                "  dipole sample --sigma-a 0.01 --sigma-s 1 --count 1000 --draw stratified "
                "--seed 7 --format csv\n"
                "  dipole sample --medium marble --model burley --count 10000\n"
                "  dipole sample --medium skin1 --model better --evaluator f32 --count 1000\n",
};
