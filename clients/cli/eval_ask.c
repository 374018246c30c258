/* What `dipole eval` asks the daemon, and the answers put together. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/eval.h"
#include "clients/cli/progress.h"

#define FROM_DEFAULT_MM 0.0
#define TO_DEFAULT_MM 10.0
#define COUNT_DEFAULT 21

/* ---- radii --------------------------------------------------------------------------------- */

cli_eval_radii cli_eval_make_radii(const cli_eval_settings *settings,
                                   const cli_eval_report *report) {
  cli_eval_radii radii = {.spacing = DIPOLE_LIST};
  if (report->quantity_count == 0) {
    return radii;
  }
  if (settings->r.count == 0) {
    radii.spacing = settings->logarithmic ? DIPOLE_LOGARITHMIC : DIPOLE_LINEAR;
    radii.count = settings->count.given ? settings->count.value : COUNT_DEFAULT;
    radii.start_mm = settings->from.given ? settings->from.value : FROM_DEFAULT_MM;
    radii.stop_mm = settings->to.given ? settings->to.value : TO_DEFAULT_MM;
    return radii;
  }
  radii.count = settings->r.count;
  radii.f64 = settings->r.items;
  radii.f32 = cli_allocate(settings->r.count, sizeof *radii.f32);
  for (size_t i = 0; i < settings->r.count; i++) {
    radii.f32[i] = (float)settings->r.items[i];
  }
  return radii;
}

/* ---- asking -------------------------------------------------------------------------------- */

typedef struct asking {
  const cli_common *common;
  dipole_client *client;
  cli_eval_report *report;
  const dipole_medium *media;
  const cli_eval_radii *radii;
  uint32_t deadline_ms;
  unsigned too_large; /* the daemon's status for a request beyond its limits, */
  unsigned bad_value; /* for one that it, or the model, does not take, */
  cli_progress *progress;
  size_t models_done, models_total;
} asking;

static void copy_values(double *to, const double *f64, const float *f32, size_t count) {
  for (size_t i = 0; i < count; i++) {
    to[i] = f64 != NULL ? f64[i] : (double)f32[i];
  }
}

/* Room for all radii of a model, once the daemon has agreed to so many. */
static double *make_room(double *values, size_t count) {
  return values != NULL ? values : cli_allocate(count, sizeof *values);
}

/* Keeps a part of the answer for the model at a place: the radii from `first` on. */
static void keep(const asking *ask, size_t place, size_t first, const dipole_result *part) {
  cli_eval_report *report = ask->report;
  const size_t count = (size_t)part->radius_count;
  report->radius_count = (size_t)ask->radii->count;
  report->radii = make_room(report->radii, report->radius_count);
  copy_values(report->radii + first, part->radius_f64, part->radius_f32, count);
  report->models[place].notes |= part->notes;
  for (size_t i = 0; i < report->channel_count; i++) {
    const dipole_channel *channel = &part->channels[i];
    cli_eval_values *values = &report->values[place * report->channel_count + i];
    values->albedo = channel->albedo;
    values->numerical_error = channel->numerical_error;
    values->numerical_error_per_mm = channel->numerical_error_per_mm;
    values->model_error = channel->model_error;
    for (size_t q = 0; q < report->quantity_count; q++) {
      const unsigned id = report->quantities[q]->id;
      values->arrays[q] = make_room(values->arrays[q], report->radius_count);
      copy_values(values->arrays[q] + first, dipole_values_f64(part, (uint32_t)i, id),
                  dipole_values_f32(part, (uint32_t)i, id), count);
    }
  }
}

/* What the model at a place is asked for the radii first, first + 1, ..., first + count - 1 of a
 * list, or for the whole grid. */
static dipole_query make_query(const asking *ask, size_t place, const cli_parameters *parameters,
                               size_t first, uint64_t count) {
  const cli_eval_radii *radii = ask->radii;
  const cli_eval_report *report = ask->report;
  const dipole_choice *model = report->models[place].choice;
  dipole_query query = {.model = model != NULL ? model->id : DIPOLE_ANY_MODEL,
                        .evaluator = report->evaluator->id,
                        .moments = report->moments->id,
                        .wanted = report->wanted | DIPOLE_RADIUS,
                        .media = ask->media,
                        .medium_count = (uint32_t)report->channel_count,
                        .spacing = radii->spacing,
                        .radius_count = count,
                        .radius_start_mm = radii->start_mm,
                        .radius_stop_mm = radii->stop_mm,
                        .parameters = parameters->items,
                        .parameter_count = parameters->count,
                        .deadline_ms = ask->deadline_ms};
  if (radii->f64 != NULL && query.evaluator == DIPOLE_F64) {
    query.radii = radii->f64 + first;
  } else if (radii->f32 != NULL) {
    query.radii = radii->f32 + first;
  }
  return query;
}

/* Notes what the daemon has chosen where no model was named. */
static bool take_choice(cli_eval_report *report, const dipole_result *result, dipole_error *error) {
  cli_eval_model *model = &report->models[0];
  if (model->choice != NULL) {
    return true;
  }
  const dipole_choice *evaluator =
      cli_choice_of_id(report->info, DIPOLE_EVALUATOR, result->evaluator);
  model->choice = cli_choice_of_id(report->info, DIPOLE_MODEL, result->model);
  if (model->choice == NULL || evaluator == NULL) {
    *error = (dipole_error){.kind = DIPOLE_ERROR_PROTOCOL,
                            .text = "the daemon chose a model or evaluator that it does not list"};
    return false;
  }
  report->evaluator = evaluator;
  return true;
}

/* Where the answer to one query goes. */
typedef struct receiving {
  const asking *ask;
  size_t place, first;
  dipole_error *error; /* when a part cannot be used */
} receiving;

/* Of the model that is asked now so many radii are there. */
static void show_progress(const asking *ask, double radii) {
  const double of_model = (double)ask->radii->count, channels = (double)ask->report->channel_count;
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

/* A list that is too long for the daemon is asked for in halves; but each half could get another
 * model where that is the daemon's to choose. */
static bool ask_piece(const asking *ask, size_t place, const cli_parameters *parameters,
                      size_t first, uint64_t count, dipole_error *error) {
  const dipole_query query = make_query(ask, place, parameters, first, count);
  dipole_error unusable = {0};
  receiving to = {.ask = ask, .place = place, .first = first, .error = &unusable};
  if (cli_eval_parts(ask->client, ask->common, &query, receive, &to, error)) {
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

/* A parameter that a model does not take is refused in this way, whatever its value. */
static bool is_not_taken(const dipole_error *error) {
  return strncmp(error->allowed, "nothing", strlen("nothing")) == 0;
}

/* Asks the model at a place; one of all models is asked without the parameters that it does not
 * take, a named one is not. */
static bool ask_model(const asking *ask, size_t place, dipole_error *error) {
  const cli_eval_report *report = ask->report;
  cli_parameters parameters = report->parameters;
  for (;;) {
    if (ask_piece(ask, place, &parameters, 0, ask->radii->count, error)) {
      return true;
    }
    const dipole_choice *refused = cli_choice(report->info, DIPOLE_PARAMETER, error->field);
    if (report->models[place].named || error->kind != DIPOLE_ERROR_REFUSED ||
        error->status != ask->bad_value || refused == NULL || !is_not_taken(error) ||
        !cli_parameters_remove(&parameters, refused->id)) {
      return false;
    }
  }
}

/* A model of all that is left out. */
typedef struct left_out {
  const char *model;
  dipole_error error;
} left_out;

/* One line for each model that is left out. When that is every one, what is wrong is hardly theirs:
 * each reason is given once. */
static int tell_left_out(const cli_command *command, const left_out *models, size_t count,
                         bool all) {
  char option[64];
  for (size_t i = 0; i < count; i++) {
    const dipole_error *error = &models[i].error;
    cli_option_of(command, error->field, option, sizeof option);
    bool told = false;
    for (size_t k = 0; k < i; k++) {
      told = told || strcmp(models[k].error.text, error->text) == 0;
    }
    if (!all) {
      cli_fail(command, "%s is left out: %s%s", models[i].model, error->text, option);
    } else if (!told) {
      cli_fail(command, "%s%s", error->text, option);
    }
  }
  return all ? CLI_FAILED : CLI_OK;
}

/* Says what is wrong; an exit status. */
static int fail(const cli_command *command, const dipole_error *error) {
  char option[64];
  cli_fail(command, "%s%s", error->text,
           cli_option_of(command, error->field, option, sizeof option));
  return CLI_FAILED;
}

/* Asks model by model; those that answer move up in the report to fill the gaps. */
static int ask_all(const cli_command *command, asking *ask) {
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
      status = fail(command, &error);
    }
    ask->models_done++;
  }
  cli_progress_wipe(ask->progress);
  report->model_count = answered;
  if (status == CLI_OK) {
    status = tell_left_out(command, out, out_count, answered == 0);
  }
  free(out);
  return status;
}

/* ---- a tolerance instead of a model -------------------------------------------------------- */

/* Asks what could answer with the report's evaluator; *taken: one keeps the tolerance. */
static bool ask_offers(const asking *ask, bool *taken, dipole_error *error) {
  cli_eval_offers *offers = &ask->report->chosen_from;
  const dipole_query query = make_query(ask, 0, &ask->report->parameters, 0, ask->radii->count);
  size_t at;
  free(offers->offers);
  offers->offers = NULL;
  const bool good =
      cli_offers(ask->client, ask->common, &query, &offers->offers, &offers->count, &at, error);
  *taken = good && at < offers->count;
  return good;
}

/* Without --evaluator single precision, which is cheaper, unless only double precision keeps the
 * tolerance. If neither does, the query is left to the daemon to refuse. */
static int choose_precision(const cli_command *command, const cli_eval_settings *settings,
                            const asking *ask) {
  static const unsigned either[] = {DIPOLE_LUT, DIPOLE_F64};
  cli_eval_report *report = ask->report;
  dipole_error error;
  bool taken = false;
  report->chosen_from.tolerance = settings->profile.tolerance.value;
  for (size_t i = 0; !taken && i < sizeof either / sizeof either[0]; i++) {
    const dipole_choice *evaluator = cli_choice_of_id(report->info, DIPOLE_EVALUATOR, either[i]);
    if (settings->evaluator == NULL && evaluator != NULL) {
      report->evaluator = evaluator;
    }
    if (!ask_offers(ask, &taken, &error)) {
      return fail(command, &error);
    }
  }
  return CLI_OK;
}

/* ---- all of it ----------------------------------------------------------------------------- */

static int ask_with(const cli_command *command, const cli_eval_settings *settings,
                    dipole_client *client, cli_eval_report *report) {
  dipole_medium *media = cli_allocate(report->channel_count, sizeof *media);
  for (size_t i = 0; i < report->channel_count; i++) {
    media[i] = report->channels[i].medium;
  }
  cli_eval_radii radii = cli_eval_make_radii(settings, report);
  cli_progress progress;
  asking ask = {.common = &settings->profile.common,
                .client = client,
                .report = report,
                .media = media,
                .radii = &radii,
                .deadline_ms = (uint32_t)settings->deadline_ms.value,
                .too_large = dipole_id(client, DIPOLE_STATUS, "too-large"),
                .bad_value = dipole_id(client, DIPOLE_STATUS, "bad-value"),
                .progress = &progress};
  cli_progress_start(&progress, "values");
  int status = CLI_OK;
  if (report->models[0].choice == NULL) {
    status = choose_precision(command, settings, &ask);
  }
  if (status == CLI_OK) {
    status = ask_all(command, &ask);
  }
  free(radii.f32);
  free(media);
  return status;
}

int cli_eval_ask(const cli_command *command, const cli_eval_settings *settings,
                 dipole_client *client, cli_eval_report *report) {
  cli_channels channels = {0};
  report->info = dipole_get_info(client);
  if (!cli_eval_choose(command, settings, report) ||
      !cli_parameters_take(command, report->info, &settings->profile, &report->parameters)) {
    return CLI_USAGE;
  }
  const int status = cli_channels_take(command, &settings->medium, client, &channels);
  if (status != CLI_OK) {
    return status;
  }
  report->medium = channels.medium;
  report->channel_count = channels.count;
  report->channels = channels.items;
  report->values_capacity = report->model_count * report->channel_count;
  report->values = cli_allocate(report->values_capacity, sizeof *report->values);
  return ask_with(command, settings, client, report);
}
