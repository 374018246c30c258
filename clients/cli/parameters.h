/* parameters: the optional numbers of a query, from options and from cells. */
#ifndef DIPOLE_CLI_PARAMETERS_H
#define DIPOLE_CLI_PARAMETERS_H

#include "clients/cli/cli.h"

/* Of a daemon's list, so many can be given. */
enum { CLI_PARAMETERS_MAX = 32 };

/* The settings of a command with cli_parameter_options start with these. */
typedef struct cli_profile_settings {
  cli_common common;
  cli_number tolerance, cos_in, cos_out, thickness, surface_albedo, gaussians, fit_from, fit_to;
  const char *fit_model;
} cli_profile_settings;

/* An option for each parameter of the protocol; its name is the parameter's, with - for _. */
extern const cli_option cli_parameter_options[];

/* Those that are given, each once. */
typedef struct cli_parameters {
  size_t count;
  dipole_parameter items[CLI_PARAMETERS_MAX];
} cli_parameters;

/* Sets a parameter, whether or not it has been set before. */
void cli_parameters_set(cli_parameters *parameters, unsigned id, double value);

/* Takes a parameter away; false when it has not been set. */
bool cli_parameters_remove(cli_parameters *parameters, unsigned id);

/* What the options give. Says what is wrong and returns false when the daemon lacks a parameter or
 * the model that one names. */
bool cli_parameters_take(const cli_command *command, const dipole_info *info,
                         const cli_profile_settings *settings, cli_parameters *parameters);

/* The first of the options that is given; NULL: none. */
const cli_option *cli_parameters_given(const cli_profile_settings *settings);

/* Reads the value of a parameter of the daemon's list: a number, or the name or id of a model. */
bool cli_parameter_parse(const dipole_info *info, const dipole_choice *parameter, const char *text,
                         double *value);

#endif
