/* What `dipole sample` asks the daemon. */
#include <stdlib.h>
#include <string.h>

#include "clients/cli/sample.h"

#define MODEL_DEFAULT "better"
#define MOMENTS_DEFAULT "exact"
#define EVALUATOR_DEFAULT "f64"
#define DRAW_DEFAULT "random"
#define DRAW_OF_A_LIST "list"
#define COUNT_DEFAULT 10
#define SEED_DEFAULT 1

/* ---- names ---------------------------------------------------------------------------------- */

static const char *or_else(const char *given, const char *otherwise) {
  return given != NULL ? given : otherwise;
}

static bool choose_quantities(const cli_command *command, const cli_sample_settings *settings,
                              cli_sample_report *report) {
  unsigned *wanted = &report->query.wanted;
  const dipole_choice *quantity;
  for (size_t i = 0; i < settings->want.count; i++) {
    quantity = cli_named(command, report->info, DIPOLE_QUANTITY, "want", settings->want.items[i]);
    if (quantity == NULL) {
      return false;
    }
    *wanted |= quantity->id;
  }
  if (settings->want.count == 0) {
    *wanted = DIPOLE_RADIUS | DIPOLE_PDF;
  }
  for (size_t from = 0;
       report->quantity_count < CLI_SAMPLE_QUANTITIES_MAX &&
       (quantity = cli_next_choice(report->info, DIPOLE_QUANTITY, &from)) != NULL;) {
    if ((*wanted & quantity->id & ~(unsigned)DIPOLE_ALBEDO) != 0) {
      report->quantities[report->quantity_count++] = quantity;
    }
  }
  if (settings->plot.count > 0) { /* which draws these, shown or not */
    *wanted |= DIPOLE_RADIUS | DIPOLE_PDF;
  }
  return true;
}

static bool choose(const cli_command *command, const cli_sample_settings *settings,
                   cli_sample_report *report) {
  const dipole_info *info = report->info;
  const struct {
    const dipole_choice **to;
    enum dipole_kind kind;
    const char *option;
    const char *name;
  } choices[] = {
      {&report->model, DIPOLE_MODEL, "model", or_else(settings->model, MODEL_DEFAULT)},
      {&report->moments, DIPOLE_MOMENTS, "moments", or_else(settings->moments, MOMENTS_DEFAULT)},
      {&report->evaluator, DIPOLE_EVALUATOR, "evaluator",
       or_else(settings->evaluator, EVALUATOR_DEFAULT)},
      {&report->draw, DIPOLE_DRAW, "draw",
       settings->u.count > 0 ? DRAW_OF_A_LIST : or_else(settings->draw, DRAW_DEFAULT)},
  };
  for (size_t i = 0; i < sizeof choices / sizeof choices[0]; i++) {
    *choices[i].to = cli_named(command, info, choices[i].kind, choices[i].option, choices[i].name);
    if (*choices[i].to == NULL) {
      return false;
    }
  }
  if (settings->u.count == 0 && report->draw->id == DIPOLE_DRAW_LIST) {
    cli_fail_usage(command, "--draw %s: give the numbers with --u", DRAW_OF_A_LIST);
    return false;
  }
  return choose_quantities(command, settings, report);
}

/* ---- numbers -------------------------------------------------------------------------------- */

static bool is_seeded(const dipole_choice *draw) {
  return draw->id == DIPOLE_DRAW_RANDOM || draw->id == DIPOLE_DRAW_STRATIFIED;
}

/* Those that are listed, in the evaluator's precision; to be freed. */
static void *list_numbers(const cli_numbers *u, unsigned evaluator) {
  if (evaluator == DIPOLE_F64) {
    double *numbers = cli_allocate(u->count, sizeof *numbers);
    memcpy(numbers, u->items, u->count * sizeof *numbers);
    return numbers;
  }
  float *numbers = cli_allocate(u->count, sizeof *numbers);
  for (size_t i = 0; i < u->count; i++) {
    numbers[i] = (float)u->items[i];
  }
  return numbers;
}

/* The numbers that radii were drawn with, as doubles. */
static bool keep_numbers(cli_sample_report *report, const void *listed, dipole_error *error) {
  const size_t value_bytes = report->query.evaluator == DIPOLE_F64 ? sizeof(double) : sizeof(float);
  void *made = NULL;
  if (listed == NULL) {
    made = cli_allocate(report->count, value_bytes);
    if (!dipole_sample_numbers(&report->query, 0, report->count, made, error)) {
      free(made);
      return false;
    }
  }
  const void *from = listed != NULL ? listed : made;
  report->u = cli_allocate(report->count, sizeof *report->u);
  for (size_t i = 0; i < report->count; i++) {
    report->u[i] = value_bytes == sizeof(double) ? ((const double *)from)[i]
                                                 : (double)((const float *)from)[i];
  }
  free(made);
  return true;
}

/* ---- asking --------------------------------------------------------------------------------- */

static dipole_sample_query make_query(const cli_sample_settings *settings,
                                      const cli_sample_report *report, const dipole_medium *media,
                                      const void *numbers) {
  const uint64_t seed = settings->seed.given ? settings->seed.value : SEED_DEFAULT;
  return (dipole_sample_query){
      .model = report->model->id,
      .evaluator = report->evaluator->id,
      .moments = report->moments->id,
      .wanted = report->query.wanted,
      .media = media,
      .medium_count = (uint32_t)report->channel_count,
      .draw = report->draw->id,
      .numbers = numbers,
      .sample_count = settings->u.count > 0   ? settings->u.count
                      : settings->count.given ? settings->count.value
                                              : COUNT_DEFAULT,
      .sample_first = settings->first.value,
      /* the daemon refuses a seed that nothing is made of, which was given in vain */
      .seed = is_seeded(report->draw) || settings->seed.given ? seed : 0,
      .parameters = report->parameters.items,
      .parameter_count = report->parameters.count,
      .deadline_ms = (unsigned)settings->deadline_ms.value,
  };
}

/* Says what is wrong; an exit status. */
static int fail(const cli_command *command, const dipole_error *error) {
  char option[64];
  cli_fail(command, "%s%s", error->text,
           cli_option_of(command, error->field, option, sizeof option));
  return CLI_FAILED;
}

static int ask(const cli_command *command, const cli_sample_settings *settings,
               dipole_client *client, cli_sample_report *report) {
  dipole_error error;
  dipole_medium *media = cli_allocate(report->channel_count, sizeof *media);
  for (size_t i = 0; i < report->channel_count; i++) {
    media[i] = report->channels[i].medium;
  }
  void *numbers = settings->u.count > 0 ? list_numbers(&settings->u, report->evaluator->id) : NULL;
  report->query = make_query(settings, report, media, numbers);
  bool good =
      cli_sample(client, &settings->profile.common, &report->query, &report->result, &error);
  if (good) {
    report->count = (size_t)report->query.sample_count;
    good = keep_numbers(report, numbers, &error);
  }
  free(numbers);
  free(media);
  report->query.numbers = NULL;
  report->query.media = NULL;
  return good ? CLI_OK : fail(command, &error);
}

int cli_sample_ask(const cli_command *command, const cli_sample_settings *settings,
                   dipole_client *client, cli_sample_report *report) {
  cli_channels channels = {0};
  report->info = dipole_get_info(client);
  if (!choose(command, settings, report) ||
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
  return ask(command, settings, client, report);
}

double cli_sample_value(const cli_sample_report *report, size_t channel, unsigned quantity,
                        size_t index) {
  const double *f64 = dipole_values_f64(report->result, (uint32_t)channel, quantity);
  return f64 != NULL
             ? f64[index]
             : (double)dipole_values_f32(report->result, (uint32_t)channel, quantity)[index];
}

void cli_sample_report_free(cli_sample_report *report) {
  free(report->channels);
  free(report->u);
  dipole_result_free(report->result);
}
