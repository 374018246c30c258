/* What `dipole eval` asks the daemon, and the answers put together. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/eval.h"

#define MODEL_DEFAULT "better"
#define MODEL_ALL "all"
#define MOMENTS_DEFAULT "exact"
#define EVALUATOR_DEFAULT "f64"
#define FROM_DEFAULT_MM 0.0
#define TO_DEFAULT_MM 10.0
#define COUNT_DEFAULT 21

/* ---- names --------------------------------------------------------------------------------- */

static void add_model(cli_eval_report *report, const dipole_choice *model, bool named) {
  for (size_t i = 0; i < report->model_count; i++) {
    if (report->models[i].choice == model) {
      report->models[i].named |= named;
      return;
    }
  }
  report->models = cli_resize(report->models, report->model_count + 1, sizeof *report->models);
  report->models[report->model_count++] = (cli_eval_model){.choice = model, .named = named};
}

static void add_all_models(cli_eval_report *report) {
  const dipole_choice *model;
  for (size_t from = 0; (model = cli_next_choice(report->info, DIPOLE_MODEL, &from)) != NULL;) {
    add_model(report, model, false);
  }
}

static bool choose_model(const cli_command *command, const char *name, cli_eval_report *report) {
  const dipole_choice *model = cli_named(command, report->info, DIPOLE_MODEL, "model", name);
  if (model != NULL) {
    add_model(report, model, true);
  }
  return model != NULL;
}

static bool choose_models(const cli_command *command, const cli_texts *names,
                          cli_eval_report *report) {
  for (size_t i = 0; i < names->count; i++) {
    if (strcmp(names->items[i], MODEL_ALL) == 0) {
      add_all_models(report);
    } else if (!choose_model(command, names->items[i], report)) {
      return false;
    }
  }
  return names->count > 0 || choose_model(command, MODEL_DEFAULT, report);
}

/* One quantity and not a sum of some, whatever the daemon lists: only then is there an array of it.
 */
static bool is_one_bit(unsigned id) {
  return id != 0 && (id & (id - 1)) == 0;
}

/* The wanted quantities that have a value for each radius: all but the albedo and the radius. */
static void list_arrays(cli_eval_report *report) {
  const dipole_choice *quantity;
  for (size_t from = 0;
       report->quantity_count < CLI_EVAL_QUANTITIES_MAX &&
       (quantity = cli_next_choice(report->info, DIPOLE_QUANTITY, &from)) != NULL;) {
    if (is_one_bit(quantity->id) &&
        (report->wanted & quantity->id & ~(unsigned)(DIPOLE_ALBEDO | DIPOLE_RADIUS)) != 0) {
      report->quantities[report->quantity_count++] = quantity;
    }
  }
}

static bool choose_quantities(const cli_command *command, const cli_texts *names,
                              cli_eval_report *report) {
  for (size_t i = 0; i < names->count; i++) {
    const dipole_choice *quantity =
        cli_named(command, report->info, DIPOLE_QUANTITY, "want", names->items[i]);
    if (quantity == NULL) {
      return false;
    }
    report->wanted |= quantity->id;
  }
  if (names->count == 0) {
    report->wanted = DIPOLE_R | DIPOLE_ALBEDO;
  }
  list_arrays(report);
  return true;
}

static bool choose(const cli_command *command, const cli_eval_settings *settings,
                   cli_eval_report *report) {
  const char *moments = settings->moments != NULL ? settings->moments : MOMENTS_DEFAULT;
  const char *evaluator = settings->evaluator != NULL ? settings->evaluator : EVALUATOR_DEFAULT;
  report->moments = cli_named(command, report->info, DIPOLE_MOMENTS, "moments", moments);
  if (report->moments == NULL) {
    return false;
  }
  report->evaluator = cli_named(command, report->info, DIPOLE_EVALUATOR, "evaluator", evaluator);
  return report->evaluator != NULL && choose_models(command, &settings->model, report) &&
         choose_quantities(command, &settings->want, report);
}

/* ---- radii --------------------------------------------------------------------------------- */

/* The radii of one query. */
typedef struct asked_radii {
  unsigned spacing;
  uint64_t count;
  double start_mm, stop_mm;
  double *f64; /* a list in the evaluator's precision: one of these two */
  float *f32;
} asked_radii;

static void make_radii(const cli_eval_settings *settings, const cli_eval_report *report,
                       asked_radii *radii) {
  const bool elementwise = report->quantity_count > 0;
  *radii = (asked_radii){.spacing = DIPOLE_LIST};
  if (!elementwise) {
    return;
  }
  if (settings->r.count == 0) {
    radii->spacing = settings->logarithmic ? DIPOLE_LOGARITHMIC : DIPOLE_LINEAR;
    radii->count = settings->count.given ? settings->count.value : COUNT_DEFAULT;
    radii->start_mm = settings->from.given ? settings->from.value : FROM_DEFAULT_MM;
    radii->stop_mm = settings->to.given ? settings->to.value : TO_DEFAULT_MM;
    return;
  }
  radii->count = settings->r.count;
  if (report->evaluator->id != DIPOLE_F64) {
    radii->f32 = cli_allocate(settings->r.count, sizeof *radii->f32);
    for (size_t i = 0; i < settings->r.count; i++) {
      radii->f32[i] = (float)settings->r.items[i];
    }
  } else {
    radii->f64 = settings->r.items;
  }
}

/* ---- asking -------------------------------------------------------------------------------- */

typedef struct asking {
  const cli_common *common;
  dipole_client *client;
  cli_eval_report *report;
  const dipole_medium *media;
  const asked_radii *radii;
  unsigned too_large; /* the daemon's status for a request beyond its limits */
  unsigned bad_value; /* and for one that it, or the model, does not take */
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

/* Keeps the answer for the model at a place and the radii from `first` on. */
static void keep(const asking *ask, size_t place, size_t first, const dipole_result *result) {
  cli_eval_report *report = ask->report;
  const size_t count = (size_t)result->radius_count;
  report->radius_count = (size_t)ask->radii->count;
  report->radii = make_room(report->radii, report->radius_count);
  copy_values(report->radii + first, result->radius_f64, result->radius_f32, count);
  report->models[place].notes |= result->notes;
  for (size_t i = 0; i < report->channel_count; i++) {
    const dipole_channel *channel = &result->channels[i];
    cli_eval_values *values = &report->values[place * report->channel_count + i];
    values->albedo = channel->albedo;
    values->numerical_error = channel->numerical_error;
    values->numerical_error_per_mm = channel->numerical_error_per_mm;
    values->model_error = channel->model_error;
    for (size_t q = 0; q < report->quantity_count; q++) {
      const unsigned id = report->quantities[q]->id;
      values->arrays[q] = make_room(values->arrays[q], report->radius_count);
      copy_values(values->arrays[q] + first, dipole_values_f64(result, (uint32_t)i, id),
                  dipole_values_f32(result, (uint32_t)i, id), count);
    }
  }
}

/* Asks the model at a place for the radii first, first + 1, ..., first + count - 1 of a list, or
 * for the whole grid. A list that is too long for the daemon is asked for in halves. */
static bool ask_part(const asking *ask, size_t place, const cli_parameters *parameters,
                     size_t first, uint64_t count, dipole_error *error) {
  const asked_radii *radii = ask->radii;
  const cli_eval_report *report = ask->report;
  dipole_query query = {.model = report->models[place].choice->id,
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
                        .parameter_count = parameters->count};
  dipole_result *result;
  if (radii->f64 != NULL) {
    query.radii = radii->f64 + first;
  } else if (radii->f32 != NULL) {
    query.radii = radii->f32 + first;
  }
  if (cli_eval(ask->client, ask->common, &query, &result, error)) {
    keep(ask, place, first, result);
    dipole_result_free(result);
    return true;
  }
  if (error->kind == DIPOLE_ERROR_REFUSED && error->status == ask->too_large &&
      radii->spacing == DIPOLE_LIST && count > 1) {
    const uint64_t half = count / 2;
    return ask_part(ask, place, parameters, first, half, error) &&
           ask_part(ask, place, parameters, first + (size_t)half, count - half, error);
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
    if (ask_part(ask, place, &parameters, 0, ask->radii->count, error)) {
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

/* What a person wrote to give a field of a request its value: " (--from)". */
static const char *option_of(const cli_command *command, const char *field, char *text,
                             size_t bytes) {
  static const struct {
    const char *field, *option;
  } others[] = {{"radius_start", "from"}, {"radius_stop", "to"}, {"radius_count", "count"}};
  for (size_t i = 0; i < sizeof others / sizeof others[0]; i++) {
    if (strcmp(others[i].field, field) == 0) {
      field = others[i].option;
    }
  }
  const cli_option *option = cli_options_find(command, field);
  text[0] = '\0';
  if (option != NULL) {
    snprintf(text, bytes, " (--%s)", option->name);
  }
  return text;
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
    option_of(command, error->field, option, sizeof option);
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

/* Asks model by model; those that answer move up in the report to fill the gaps. */
static int ask_all(const cli_command *command, const asking *ask) {
  cli_eval_report *report = ask->report;
  const size_t count = report->model_count;
  left_out *out = cli_allocate(count, sizeof *out);
  size_t answered = 0, out_count = 0;
  char option[64];
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
      status = cli_fail(command, "%s%s", error.text,
                        option_of(command, error.field, option, sizeof option));
    }
  }
  report->model_count = answered;
  if (status == CLI_OK) {
    status = tell_left_out(command, out, out_count, answered == 0);
  }
  free(out);
  return status;
}

int cli_eval_ask(const cli_command *command, const cli_eval_settings *settings,
                 dipole_client *client, cli_eval_report *report) {
  asked_radii radii;
  report->info = dipole_get_info(client);
  if (!choose(command, settings, report) ||
      !cli_parameters_take(command, report->info, &settings->profile, &report->parameters)) {
    return CLI_USAGE;
  }
  const int status = cli_eval_media(command, settings, client, report);
  if (status != CLI_OK) {
    return status;
  }
  report->values_capacity = report->model_count * report->channel_count;
  report->values = cli_allocate(report->values_capacity, sizeof *report->values);
  dipole_medium *media = cli_allocate(report->channel_count, sizeof *media);
  for (size_t i = 0; i < report->channel_count; i++) {
    media[i] = report->channels[i].medium;
  }
  make_radii(settings, report, &radii);
  const asking ask = {.common = &settings->profile.common,
                      .client = client,
                      .report = report,
                      .media = media,
                      .radii = &radii,
                      .too_large = dipole_id(client, DIPOLE_STATUS, "too-large"),
                      .bad_value = dipole_id(client, DIPOLE_STATUS, "bad-value")};
  const int asked = ask_all(command, &ask);
  free(radii.f32);
  free(media);
  return asked;
}
