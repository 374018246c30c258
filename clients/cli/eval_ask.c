/* Asks a daemon for profiles, model by model, and puts the answers together. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/eval.h"
#include "clients/cli/number.h"
#include "clients/cli/progress.h"

#define MODEL_ALL "all"

/* ---- models ---------------------------------------------------------------------------------- */

static bool choose_model(const char *name, cli_eval_report *report) {
  const dipole_choice *model = cli_named(report->profile.info, DIPOLE_MODEL, "model", name);
  if (model != NULL) {
    cli_eval_add_model(report, model, true);
  }
  return model != NULL;
}

static bool choose_models(const cli_eval_settings *settings, cli_eval_report *report) {
  const cli_texts *names = &settings->model;
  if (names->count == 0 && settings->profile.tolerance.given) {
    cli_eval_add_model(report, NULL, true); /* the daemon chooses */
    return true;
  }
  for (size_t i = 0; i < names->count; i++) {
    const dipole_choice *model;
    if (strcmp(names->items[i], MODEL_ALL) != 0) {
      if (!choose_model(names->items[i], report)) {
        return false;
      }
      continue;
    }
    for (size_t from = 0;
         (model = cli_next_choice(report->profile.info, DIPOLE_MODEL, &from)) != NULL;) {
      cli_eval_add_model(report, model, false);
    }
  }
  return names->count > 0 || choose_model(CLI_MODEL_DEFAULT, report);
}

/* Like one of all models, the reference takes what it can of the parameters. */
static bool choose_reference(const char *name, cli_eval_report *report) {
  const dipole_choice *model = cli_choice(report->profile.info, DIPOLE_MODEL, name);
  const size_t listed = report->model_count;
  if (model == NULL) {
    cli_fail("this daemon has no model %s to compare with: leave --error out", name);
    return false;
  }
  cli_eval_add_model(report, model, false);
  report->models[report->model_count - 1].unlisted = report->model_count > listed;
  return true;
}

/* ---- radii ----------------------------------------------------------------------------------- */

cli_eval_radii cli_eval_make_radii(const cli_eval_settings *settings,
                                   const cli_eval_report *report) {
  cli_eval_radii radii = {.spacing = DIPOLE_LIST};
  if (report->quantities.count == 0) {
    return radii;
  }
  const cli_numbers *list = settings->at_f ? &settings->f : &settings->r;
  if (list->count == 0) {
    radii.spacing = settings->logarithmic ? DIPOLE_LOGARITHMIC : DIPOLE_LINEAR;
    radii.count = settings->count.value;
    radii.start_mm = settings->from.value;
    radii.stop_mm = settings->to.value;
    return radii;
  }
  radii.count = list->count;
  radii.f64 = list->items;
  radii.f32 = cli_allocate(list->count, sizeof *radii.f32);
  for (size_t i = 0; i < list->count; i++) {
    radii.f32[i] = (float)list->items[i];
  }
  return radii;
}

/* ---- asking ---------------------------------------------------------------------------------- */

typedef struct asking {
  const cli_eval_settings *settings;
  dipole_client *client;
  cli_eval_report *report;
  const cli_eval_radii *radii;
  unsigned too_large; /* the daemon's status for a request beyond its limits */
  unsigned bad_value; /* the daemon's status for a value that it, or the model, does not take */
  cli_progress *progress;
  size_t models_done, models_total;
} asking;

static void copy_values(double *to, const double *f64, const float *f32, size_t count) {
  for (size_t i = 0; i < count; i++) {
    to[i] = f64 != NULL ? f64[i] : cli_number_of_single(f32[i]);
  }
}

/* Makes room for all radii of a model, once the daemon has agreed to so many. */
static double *make_room(double *values, size_t count) {
  return values != NULL ? values : cli_allocate(count, sizeof *values);
}

/* Returns the larger number, or NaN if either is NaN. */
static double larger(double a, double b) {
  return isnan(a) || a > b ? a : b;
}

/* Keeps a part of the answer: the radii from `first` on of the model at a place. */
static void keep(const asking *ask, size_t place, size_t first, const dipole_result *part) {
  cli_eval_report *report = ask->report;
  const size_t count = (size_t)part->radius_count;
  report->radius_count = (size_t)ask->radii->count;
  report->radii = make_room(report->radii, report->radius_count);
  copy_values(report->radii + first, part->radius_f64, part->radius_f32, count);
  for (size_t i = first; ask->radii->spacing != DIPOLE_LIST && i < first + count; i++) {
    report->radii[i] = cli_number_rounded(report->radii[i]);
  }
  report->models[place].notes |= part->notes;
  for (size_t i = 0; i < report->profile.channel_count; i++) {
    const dipole_channel *channel = &part->channels[i];
    cli_eval_values *values = &report->values[place * report->profile.channel_count + i];
    values->albedo = channel->albedo;
    values->numerical_error = channel->numerical_error;
    values->numerical_error_per_mm = channel->numerical_error_per_mm;
    /* A list is asked for in pieces, which state the errors of their own radii. */
    values->model_error =
        first == 0 ? channel->model_error : larger(values->model_error, channel->model_error);
    for (size_t q = 0; q < report->quantities.count; q++) {
      const unsigned id = report->quantities.items[q]->id;
      values->arrays[q] = make_room(values->arrays[q], report->radius_count);
      copy_values(values->arrays[q] + first, dipole_values_f64(part, (uint32_t)i, id),
                  dipole_values_f32(part, (uint32_t)i, id), count);
    }
  }
}

/* Returns what the model at a place is asked: for `count` radii of a list from number `first` on,
 * or for the whole grid. */
static dipole_query make_query(const asking *ask, size_t place, const cli_parameters *parameters,
                               size_t first, uint64_t count) {
  const cli_eval_radii *radii = ask->radii;
  const cli_eval_report *report = ask->report;
  const dipole_choice *model = report->models[place].choice;
  dipole_query query = {.model = model != NULL ? model->id : DIPOLE_ANY_MODEL,
                        .evaluator = report->models[place].evaluator->id,
                        .moments = report->profile.moments->id,
                        .wanted = report->quantities.wanted | DIPOLE_RADIUS | DIPOLE_MODEL_ERROR,
                        .media = report->profile.media,
                        .medium_count = (uint32_t)report->profile.channel_count,
                        .spacing = radii->spacing,
                        .radius_count = count,
                        .radius_start_mm = radii->start_mm,
                        .radius_stop_mm = radii->stop_mm,
                        .parameters = parameters->items,
                        .parameter_count = parameters->count,
                        .deadline_ms = (uint32_t)ask->settings->profile.deadline_ms.value};
  if (radii->f64 != NULL && query.evaluator == DIPOLE_F64) {
    query.radii = radii->f64 + first;
  } else if (radii->f32 != NULL) {
    query.radii = radii->f32 + first;
  }
  return query;
}

/* Keeps the daemon's choice of model and evaluator if no model was named. */
static bool take_choice(cli_eval_report *report, const dipole_result *result, dipole_error *error) {
  cli_eval_model *model = &report->models[0];
  if (model->choice != NULL) {
    return true;
  }
  const dipole_choice *evaluator =
      cli_choice_of_id(report->profile.info, DIPOLE_EVALUATOR, result->evaluator);
  model->choice = cli_choice_of_id(report->profile.info, DIPOLE_MODEL, result->model);
  if (model->choice == NULL || evaluator == NULL) {
    *error = (dipole_error){.kind = DIPOLE_ERROR_PROTOCOL,
                            .text = "the daemon chose a model or evaluator that it does not list"};
    return false;
  }
  model->evaluator = evaluator;
  return true;
}

/* What receive() needs to know of the query whose answer it takes. */
typedef struct receiving {
  const asking *ask;
  size_t place, first;
  dipole_error *error; /* says why a part of the answer cannot be used */
} receiving;

/* Shows the progress. radii: how many radii of the current model have been answered. */
static void show_progress(const asking *ask, double radii) {
  const double of_model = (double)ask->radii->count,
               channels = (double)ask->report->profile.channel_count;
  if (of_model > 0) {
    const double done = (double)ask->models_done * of_model + radii;
    cli_progress_show(ask->progress, done / ((double)ask->models_total * of_model),
                      channels * done);
  }
}

static bool receive(void *context, const dipole_result *part, uint64_t radius_first) {
  const receiving *to = context;
  if (!take_choice(to->ask->report, part, to->error)) {
    return false;
  }
  keep(to->ask, to->place, to->first + (size_t)radius_first, part);
  show_progress(to->ask, (double)to->first + (double)radius_first + (double)part->radius_count);
  return true;
}

/* Asks for `count` radii. A list that is too long for the daemon is asked for in halves, but not
 * where the daemon chooses the model: then each half could get another one. */
static bool ask_piece(const asking *ask, size_t place, const cli_parameters *parameters,
                      size_t first, uint64_t count, dipole_error *error) {
  const dipole_query query = make_query(ask, place, parameters, first, count);
  dipole_error unusable = {0};
  receiving to = {.ask = ask, .place = place, .first = first, .error = &unusable};
  if (CLI_ASK(&ask->settings->profile.common, error,
              dipole_eval_parts(ask->client, &query, receive, &to, error))) {
    return true;
  }
  if (error->kind == DIPOLE_ERROR_STOPPED) {
    *error = unusable;
    return false;
  }
  if (error->kind == DIPOLE_ERROR_REFUSED && error->status == ask->too_large &&
      query.spacing == DIPOLE_LIST && query.model != DIPOLE_ANY_MODEL && count > 1) {
    const uint64_t half = count / 2;
    return ask_piece(ask, place, parameters, first, half, error) &&
           ask_piece(ask, place, parameters, first + (size_t)half, count - half, error);
  }
  return false;
}

/* Returns whether a parameter was refused because the model does not take it, whatever its value.
 */
static bool is_not_taken(const dipole_error *error) {
  return strncmp(error->allowed, "nothing", strlen("nothing")) == 0;
}

/* Asks the model at a place. One of all models is asked without the parameters that it does not
 * take; a named one has to take them. */
static bool ask_model(const asking *ask, size_t place, dipole_error *error) {
  const cli_eval_report *report = ask->report;
  cli_parameters parameters = report->profile.parameters;
  for (;;) {
    if (ask_piece(ask, place, &parameters, 0, ask->radii->count, error)) {
      return true;
    }
    const dipole_choice *refused = cli_choice(report->profile.info, DIPOLE_PARAMETER, error->field);
    if (report->models[place].named || error->kind != DIPOLE_ERROR_REFUSED ||
        error->status != ask->bad_value || refused == NULL || !is_not_taken(error) ||
        !cli_parameters_remove(&parameters, refused->id)) {
      return false;
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
static int tell_left_out(const left_out *models, size_t count, bool all) {
  for (size_t i = 0; i < count; i++) {
    char what[96];
    bool told = false;
    for (size_t k = 0; k < i; k++) {
      told = told || strcmp(models[k].error.text, models[i].error.text) == 0;
    }
    snprintf(what, sizeof what, "%s is left out: ", models[i].model);
    if (!all || !told) {
      cli_fail_error_of(all ? "" : what, &models[i].error);
    }
  }
  return all ? CLI_FAILED : CLI_OK;
}

/* Says why a model has not answered. Names it if another model might have, as with a parameter that
 * this one needs or does not take. model: NULL if the daemon was to choose it. */
static int fail_model(const asking *ask, const dipole_choice *model, const dipole_error *error) {
  char what[96] = "";
  if (model != NULL && error->kind == DIPOLE_ERROR_REFUSED && error->status == ask->bad_value &&
      cli_choice(ask->report->profile.info, DIPOLE_PARAMETER, error->field) != NULL) {
    snprintf(what, sizeof what, "model %s: ", model->name);
  }
  return cli_fail_error_of(what, error);
}

/* Asks model by model. Those that answer move up in the report to fill the gaps. */
static int ask_all(asking *ask) {
  cli_eval_report *report = ask->report;
  const size_t count = report->model_count;
  ask->models_total = count;
  left_out *out = cli_allocate(count, sizeof *out);
  size_t answered = 0, out_count = 0;
  int status = CLI_OK;
  for (size_t model = 0; status == CLI_OK && model < count; model++) {
    dipole_error error;
    report->models[answered] = report->models[model];
    const cli_eval_model *asked = &report->models[answered];
    if (ask_model(ask, answered, &error)) {
      answered++;
    } else if (!asked->named && error.kind == DIPOLE_ERROR_REFUSED &&
               error.status == ask->bad_value) {
      out[out_count++] = (left_out){asked->choice->name, error};
    } else {
      cli_progress_wipe(ask->progress);
      status = fail_model(ask, asked->choice, &error);
    }
    ask->models_done++;
  }
  cli_progress_wipe(ask->progress);
  report->model_count = answered;
  if (status == CLI_OK) {
    status = tell_left_out(out, out_count, answered == 0);
  }
  free(out);
  return status;
}

/* ---- a tolerance instead of a model ---------------------------------------------------------- */

/* Asks which models could answer with the report's evaluator. Sets *taken if one of them keeps the
 * tolerance. */
static bool ask_offers(const asking *ask, bool *taken, dipole_error *error) {
  cli_eval_offers *offers = &ask->report->chosen_from;
  const dipole_query query =
      make_query(ask, 0, &ask->report->profile.parameters, 0, ask->radii->count);
  size_t at;
  free(offers->offers);
  offers->offers = NULL;
  const bool good =
      CLI_ASK(&ask->settings->profile.common, error,
              dipole_offers(ask->client, &query, &offers->offers, &offers->count, &at, error));
  *taken = good && at < offers->count;
  return good;
}

/* Without --evaluator, takes single precision, which is cheaper, unless only double precision keeps
 * the tolerance. If neither does, the daemon will refuse the query. */
static int choose_precision(const asking *ask) {
  static const unsigned either[] = {DIPOLE_LUT, DIPOLE_F64};
  cli_eval_report *report = ask->report;
  dipole_error error;
  bool taken = false;
  report->chosen_from.tolerance = ask->settings->profile.tolerance.value;
  for (size_t i = 0; !taken && i < sizeof either / sizeof either[0]; i++) {
    const dipole_choice *evaluator =
        cli_choice_of_id(report->profile.info, DIPOLE_EVALUATOR, either[i]);
    if (ask->settings->profile.evaluator == NULL && evaluator != NULL) {
      report->models[0].evaluator = evaluator;
    }
    if (!ask_offers(ask, &taken, &error)) {
      return cli_fail_error(&error);
    }
  }
  return CLI_OK;
}

/* ---- all of it ------------------------------------------------------------------------------- */

static int ask_with(const cli_eval_settings *settings, dipole_client *client,
                    cli_eval_report *report) {
  cli_eval_radii radii = cli_eval_make_radii(settings, report);
  cli_progress progress;
  asking ask = {.settings = settings,
                .client = client,
                .report = report,
                .radii = &radii,
                .too_large = dipole_id(client, DIPOLE_STATUS, "too-large"),
                .bad_value = dipole_id(client, DIPOLE_STATUS, "bad-value"),
                .progress = &progress};
  cli_progress_start(&progress, "values");
  int status = report->models[0].choice == NULL ? choose_precision(&ask) : CLI_OK;
  if (status == CLI_OK) {
    status = ask_all(&ask);
  }
  free(radii.f32);
  return status;
}

int cli_eval_ask(const cli_eval_settings *settings, dipole_client *client,
                 cli_eval_report *report) {
  cli_profile_settings profile = settings->profile;
  profile.moments = profile.moments != NULL ? profile.moments : "exact";
  const int status = cli_profile_take(&profile, client, &report->profile);
  if (status != CLI_OK) {
    return status;
  }
  if (!choose_models(settings, report) ||
      (settings->reference != NULL && !choose_reference(settings->reference, report)) ||
      !cli_quantities_take(report->profile.info, &settings->wanted,
                           DIPOLE_ALBEDO | (settings->at_f ? DIPOLE_TRANSFER : DIPOLE_R),
                           DIPOLE_ALBEDO | DIPOLE_RADIUS, &report->quantities)) {
    return CLI_USAGE;
  }
  if (settings->at_f && !cli_eval_is_by_f(report)) {
    return cli_fail_usage("--f gives spatial frequencies, which only R_f has: ask for R_f alone");
  }
  for (size_t i = 0; i < report->model_count; i++) {
    cli_eval_model *model = &report->models[i];
    const char *name = model->choice != NULL ? model->choice->name : NULL;
    model->evaluator = report->profile.evaluator != NULL
                           ? report->profile.evaluator
                           : cli_choice(report->profile.info, DIPOLE_EVALUATOR,
                                        cli_usual_evaluator(&profile, name));
  }
  cli_eval_make_values(report);
  return ask_with(settings, client, report);
}
