/* mc: what `dipole mc` asks for and what it got, as its parts share it. */
#ifndef DIPOLE_CLI_MC_H
#define DIPOLE_CLI_MC_H

#include "clients/cli/cli.h"
#include "clients/cli/progress.h"

typedef struct cli_mc_settings {
  cli_common common;
  const char *medium, *channel;
  cli_number sigma_a, sigma_s, g, eta;
  cli_number thickness;
  cli_numbers albedo;
  cli_number from, to;
  cli_count rings;
  bool logarithmic;
  cli_number photons, error, total_error;
  cli_count seed;
} cli_mc_settings;

typedef struct cli_mc_report {
  const dipole_info *info;
  const char *medium, *channel; /* of a measured medium; NULL: given by numbers */
  dipole_mc_query query;
  const dipole_mc_result *result;
} cli_mc_report;

/* ---- mc_ask.c ------------------------------------------------------------------------------ */

/* What can be seen to be wrong without a daemon: an exit status. */
int cli_mc_check(const cli_command *command, const cli_mc_settings *settings);

/* Fills the report's query. Says what is wrong and returns an exit status. */
int cli_mc_query(const cli_command *command, const cli_mc_settings *settings, dipole_client *client,
                 cli_mc_report *report);

/* ---- mc_progress.c ------------------------------------------------------------------------- */

/* A bar on standard error, when somebody can see it: photons, time left, the worst ring. */
void cli_mc_progress(cli_progress *progress, const dipole_mc_progress *now);

/* ---- mc_write.c ---------------------------------------------------------------------------- */

void cli_mc_write_table(const cli_mc_report *report, FILE *file);
void cli_mc_write_csv(const cli_mc_report *report, FILE *file);
void cli_mc_write_json(const cli_mc_report *report, FILE *file);

#endif
