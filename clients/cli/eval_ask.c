/* Asks a daemon for profiles, model by model, and puts the answers together. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/eval.h"
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

static bool choose_models(const cli_settings *settings, cli_eval_report *report) {
  const cli_texts *names = &settings->model;
  if (names->count == 0 && settings->parameters[CORE_PARAMETER_TOLERANCE].text != NULL) {
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
static bool choose_reference(cli_eval_report *report) {
  const dipole_choice *model = cli_choice(report->profile.info, DIPOLE_MODEL, CLI_MODEL_DEFAULT);
  if (model == NULL) {
    cli_fail("this daemon has no model " CLI_MODEL_DEFAULT " to compare with: leave --error out");
    return false;
  }
  cli_eval_add_model(report, model, false);
  return true;
}

/* ---- quantities and radii ----------------------------------------------------------------------------------- */

bool cli_eval_take_quantities(const cli_settings *settings, cli_eval_report *report) {
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
  const unsigned others =
      report->quantities.wanted & ~(unsigned)(DIPOLE_ALBEDO | DIPOLE_RADIUS | DIPOLE_MODEL_ERRORS);
  report->place = others == DIPOLE_TRANSFER ? "f" : "r";
  if (at_f && others != DIPOLE_TRANSFER) {
    cli_fail_usage("--f gives spatial frequencies, which only R_f has: ask for R_f alone");
    return false;
  }
  return true;
}

cli_eval_radii cli_eval_make_radii(const cli_settings *settings, const cli_eval_report *report) {
  cli_eval_radii radii = {.spacing = DIPOLE_LIST};
  if ((report->quantities.wanted & ~(unsigned)(DIPOLE_ALBEDO | DIPOLE_RADIUS)) == 0) {
    return radii;
  }
  const cli_numbers *list = settings->f.count > 0 ? &settings->f : &settings->r;
  if (list->count == 0) {
    radii.spacing = settings->log ? DIPOLE_LOGARITHMIC : DIPOLE_LINEAR;
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
  const cli_settings *settings;
  dipole_client *client;
  cli_eval_report *report;
  const cli_eval_radii *radii;
  unsigned too_large; /* the daemon's status for a request beyond its limits */
  unsigned bad_value; /* the daemon's status for a value that it, or the model, does not take */
  cli_progress *progress;
  size_t models_done, models_total;
} asking;

/* Keeps a part of the answer: the radii from `first` on of the model at a place. */
static void keep(const asking *ask, size_t place, size_t first, const dipole_result *part) {
  cli_eval_report *report = ask->report;
  const bool is_grid = ask->radii->spacing != DIPOLE_LIST;
  if (report->places == NULL) {
    report->place_count = (size_t)ask->radii->count;
    report->places = cli_allocate(report->place_count, sizeof *report->places);
  }
  for (size_t i = 0; i < part->radius_count; i++) {
    const double r =
        part->radius_f64 != NULL ? part->radius_f64[i] : cli_number_of_single(part->radius_f32[i]);
    report->places[first + i] = is_grid ? cli_number_rounded(r) : r;
  }
  cli_eval_keep(report, place, first, part);
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
                        .deadline_ms = (uint32_t)ask->settings->deadline_ms.value};
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
  if (CLI_ASK(ask->settings, error, dipole_eval_parts(ask->client, &query, receive, &to, error))) {
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

/* Without a model and without --evaluator, takes single precision, which is cheaper, unless only
 * double precision keeps the tolerance. */
static bool ask_any_model(const asking *ask, dipole_error *error) {
  cli_eval_model *model = &ask->report->models[0];
  ask->report->chosen = true;
  if (ask->settings->evaluator == NULL) {
    model->evaluator = cli_choice_of_id(ask->report->profile.info, DIPOLE_EVALUATOR, DIPOLE_LUT);
    if (model->evaluator != NULL &&
        ask_piece(ask, 0, &ask->report->profile.parameters, 0, ask->radii->count, error)) {
      return true;
    }
    model->evaluator = cli_choice_of_id(ask->report->profile.info, DIPOLE_EVALUATOR, DIPOLE_F64);
    if (error->kind != DIPOLE_ERROR_REFUSED || strcmp(error->field, "tolerance") != 0) {
      return false;
    }
  }
  return ask_piece(ask, 0, &ask->report->profile.parameters, 0, ask->radii->count, error);
}

/* Asks the model at a place. One of all models is asked without the parameters that it does not
 * take; a named one has to take them. */
static bool ask_model(const asking *ask, size_t place, dipole_error *error) {
  const cli_eval_report *report = ask->report;
  cli_parameters parameters = report->profile.parameters;
  if (report->models[place].choice == NULL) {
    return ask_any_model(ask, error);
  }
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
  return status;
}

/* ---- all of it ------------------------------------------------------------------------------- */

static int ask_with(const cli_settings *settings, dipole_client *client, cli_eval_report *report) {
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
  return ask_all(&ask);
}

int cli_eval_ask(const cli_settings *settings, dipole_client *client, cli_eval_report *report) {
  const int status = cli_profile_take(settings, client, &report->profile);
  if (status != CLI_OK) {
    return status;
  }
  if (!choose_models(settings, report) || (settings->deviation && !choose_reference(report)) ||
      !cli_eval_take_quantities(settings, report)) {
    return CLI_USAGE;
  }
  for (size_t i = 0; i < report->model_count; i++) {
    cli_eval_model *model = &report->models[i];
    const char *name = model->choice != NULL ? model->choice->name : NULL;
    model->evaluator = report->profile.evaluator != NULL
                           ? report->profile.evaluator
                           : cli_choice(report->profile.info, DIPOLE_EVALUATOR,
                                        cli_usual_evaluator(settings, name));
  }
  report->profile.evaluator = NULL; /* each row has its own */
  cli_eval_make_values(report);
  return ask_with(settings, client, report);
}
