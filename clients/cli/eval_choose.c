/* What the names on the command line of `dipole eval` stand for at this daemon. */
#include <string.h>

#include "clients/cli/eval.h"

#define MODEL_DEFAULT "better"
#define MODEL_ALL "all"
#define MOMENTS_DEFAULT "exact"
#define EVALUATOR_DEFAULT "f64"

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

/* The model is the daemon's to choose. */
static void leave_model_open(cli_eval_report *report) {
  report->models = cli_resize(report->models, 1, sizeof *report->models);
  report->models[0] = (cli_eval_model){.named = true};
  report->model_count = 1;
}

static bool choose_listed_models(const cli_command *command, const cli_eval_settings *settings,
                                 cli_eval_report *report) {
  const cli_texts *names = &settings->model;
  if (names->count == 0 && settings->profile.tolerance.given) {
    leave_model_open(report);
    return true;
  }
  for (size_t i = 0; i < names->count; i++) {
    if (strcmp(names->items[i], MODEL_ALL) == 0) {
      add_all_models(report);
    } else if (!choose_model(command, names->items[i], report)) {
      return false;
    }
  }
  return names->count > 0 || choose_model(command, MODEL_DEFAULT, report);
}

/* Like one of all models, the reference takes what it can of the parameters. */
static bool choose_reference(const cli_command *command, const char *name,
                             cli_eval_report *report) {
  const dipole_choice *model = cli_choice(report->info, DIPOLE_MODEL, name);
  const size_t listed = report->model_count;
  if (model == NULL) {
    cli_fail(command, "this daemon has no model %s to compare with", name);
    return false;
  }
  add_model(report, model, false);
  report->models[report->model_count - 1].unlisted = report->model_count > listed;
  return true;
}

static bool choose_models(const cli_command *command, const cli_eval_settings *settings,
                          cli_eval_report *report) {
  return choose_listed_models(command, settings, report) &&
         (settings->reference == NULL || choose_reference(command, settings->reference, report));
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

bool cli_eval_choose_quantities(const cli_command *command, const cli_texts *names,
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

bool cli_eval_choose(const cli_command *command, const cli_eval_settings *settings,
                     cli_eval_report *report) {
  const char *moments = settings->moments != NULL ? settings->moments : MOMENTS_DEFAULT;
  const char *evaluator = settings->evaluator != NULL ? settings->evaluator : EVALUATOR_DEFAULT;
  report->moments = cli_named(command, report->info, DIPOLE_MOMENTS, "moments", moments);
  if (report->moments == NULL) {
    return false;
  }
  report->evaluator = cli_named(command, report->info, DIPOLE_EVALUATOR, "evaluator", evaluator);
  return report->evaluator != NULL && choose_models(command, settings, report) &&
         cli_eval_choose_quantities(command, &settings->want, report);
}
