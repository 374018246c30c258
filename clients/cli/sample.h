/* sample: what `dipole sample` asks for and what it got, as its parts share it. */
#ifndef DIPOLE_CLI_SAMPLE_H
#define DIPOLE_CLI_SAMPLE_H

#include "clients/cli/channels.h"
#include "clients/cli/cli.h"
#include "clients/cli/parameters.h"

typedef struct cli_sample_settings {
  cli_profile_settings profile;
  cli_medium_settings medium;
  cli_numbers u;
  cli_count count, seed, first;
  const char *draw;
  const char *model, *moments, *evaluator;
  cli_texts want;
  cli_count deadline_ms;
  cli_texts plot;
} cli_sample_settings;

enum { CLI_SAMPLE_QUANTITIES_MAX = 32 };

typedef struct cli_sample_report {
  const dipole_info *info;
  const char *medium; /* name of a measured medium; NULL: none */
  const dipole_choice *model, *evaluator, *moments, *draw;
  cli_parameters parameters;
  dipole_sample_query query;
  size_t channel_count;
  cli_channel *channels;
  size_t quantity_count; /* of those wanted that have a value for each radius, r among them */
  const dipole_choice *quantities[CLI_SAMPLE_QUANTITIES_MAX]; /* in the daemon's order */
  size_t count;
  double *u; /* [count] */
  dipole_result *result;
} cli_sample_report;

/* A value of the result; those of single precision are the doubles that they equal. */
double cli_sample_value(const cli_sample_report *report, size_t channel, unsigned quantity,
                        size_t index);

/* ---- sample_ask.c: fills a zeroed report; says what is wrong and returns an exit status ------ */

int cli_sample_ask(const cli_command *command, const cli_sample_settings *settings,
                   dipole_client *client, cli_sample_report *report);
void cli_sample_report_free(cli_sample_report *report);

/* ---- sample_write.c -------------------------------------------------------------------------- */

void cli_sample_write_table(const cli_sample_report *report, FILE *file);
void cli_sample_write_csv(const cli_sample_report *report, FILE *file);
void cli_sample_write_json(const cli_sample_report *report, FILE *file);

/* ---- sample_plot.c --------------------------------------------------------------------------- */

/* Draws a histogram of the radii, and their density, into a file whose name has been checked; an
 * exit status. r and pdf are in the result. */
int cli_sample_plot(const cli_command *command, const cli_sample_report *report, const char *path);

#endif
