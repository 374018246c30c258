#include "clients/cli/parameters.h"

#include <string.h>

#include "clients/cli/number.h"

#define FIELD(name) offsetof(cli_profile_settings, name)

const cli_option cli_parameter_options[] = {
    {"Parameters, for the models that take them", NULL, NULL, CLI_HEADING, 0},
    {"tolerance", "X",
     "numerical error asked for, relative, where a model can choose; what\n"
     "tables are built to",
     CLI_NUMBER, FIELD(tolerance)},
    {"cos-in", "X", "cosine of the angle of incidence, for S (default: 1)", CLI_NUMBER,
     FIELD(cos_in)},
    {"cos-out", "X", "cosine of the angle of exit, for S (default: 1)", CLI_NUMBER, FIELD(cos_out)},
    {"thickness", "X", "of a slab, mm; its models need it", CLI_NUMBER, FIELD(thickness)},
    {"surface-albedo", "X", "Burley's A (default: the better dipole's albedo)", CLI_NUMBER,
     FIELD(surface_albedo)},
    {"gaussians", "N", "how many are fitted (default: 6)", CLI_NUMBER, FIELD(gaussians)},
    {"fit-model", "NAME", "model that is fitted, or its id (default: better)", CLI_TEXT,
     FIELD(fit_model)},
    {"fit-from", "X", "least radius of a fit, mm (default: 0.1 mean free paths)", CLI_NUMBER,
     FIELD(fit_from)},
    {"fit-to", "X", "largest radius of a fit, mm (default: 10 mean free paths)", CLI_NUMBER,
     FIELD(fit_to)},
    {0},
};

void cli_parameters_set(cli_parameters *parameters, unsigned id, double value) {
  cli_parameters_remove(parameters, id);
  if (parameters->count < CLI_PARAMETERS_MAX) {
    parameters->items[parameters->count++] = (dipole_parameter){id, value};
  }
}

bool cli_parameters_remove(cli_parameters *parameters, unsigned id) {
  for (size_t i = 0; i < parameters->count; i++) {
    if (parameters->items[i].id == id) {
      parameters->items[i] = parameters->items[--parameters->count];
      return true;
    }
  }
  return false;
}

/* The daemon's parameter that an option stands for; NULL: it has none. */
static const dipole_choice *parameter_of(const dipole_info *info, const char *option) {
  char name[64];
  snprintf(name, sizeof name, "%s", option);
  for (char *dash; (dash = strchr(name, '-')) != NULL;) {
    *dash = '_';
  }
  return cli_choice(info, DIPOLE_PARAMETER, name);
}

static bool parse_model(const dipole_info *info, const char *text, double *value) {
  const dipole_choice *model = cli_choice(info, DIPOLE_MODEL, text);
  if (model != NULL) {
    *value = model->id;
  }
  return model != NULL || cli_number_parse(text, value);
}

bool cli_parameter_parse(const dipole_info *info, const dipole_choice *parameter, const char *text,
                         double *value) {
  for (const cli_option *option = cli_parameter_options; option->name != NULL; option++) {
    if (option->kind == CLI_TEXT && parameter_of(info, option->name) == parameter) {
      return parse_model(info, text, value);
    }
  }
  return cli_number_parse(text, value);
}

/* True when the option is given; its value then, or false in *good when it is no model. */
static bool get_value(const dipole_info *info, const cli_profile_settings *settings,
                      const cli_option *option, double *value, bool *good) {
  const char *at = (const char *)settings + option->offset;
  *good = true;
  if (option->kind == CLI_TEXT) {
    const char *text = *(const char *const *)(const void *)at;
    *good = text == NULL || parse_model(info, text, value);
    return text != NULL;
  }
  const cli_number *number = (const cli_number *)(const void *)at;
  *value = number->value;
  return number->given;
}

const cli_option *cli_parameters_given(const cli_profile_settings *settings) {
  for (const cli_option *option = cli_parameter_options; option->name != NULL; option++) {
    const char *at = (const char *)settings + option->offset;
    if (option->kind == CLI_HEADING) {
      continue;
    }
    if (option->kind == CLI_TEXT ? *(const char *const *)(const void *)at != NULL
                                 : ((const cli_number *)(const void *)at)->given) {
      return option;
    }
  }
  return NULL;
}

bool cli_parameters_take(const cli_command *command, const dipole_info *info,
                         const cli_profile_settings *settings, cli_parameters *parameters) {
  char known[1024];
  double value = 0;
  bool good;
  *parameters = (cli_parameters){0};
  for (const cli_option *option = cli_parameter_options; option->name != NULL; option++) {
    if (option->kind == CLI_HEADING || !get_value(info, settings, option, &value, &good)) {
      continue;
    }
    const dipole_choice *parameter = parameter_of(info, option->name);
    if (parameter == NULL) {
      cli_list_names(info, DIPOLE_PARAMETER, known, sizeof known);
      cli_fail_usage(command, "--%s: this daemon does not know it; it knows %s", option->name,
                     known);
      return false;
    }
    if (!good) {
      cli_list_names(info, DIPOLE_MODEL, known, sizeof known);
      cli_fail_usage(command, "--%s: there is no such model; this daemon has %s", option->name,
                     known);
      return false;
    }
    cli_parameters_set(parameters, parameter->id, value);
  }
  return true;
}
