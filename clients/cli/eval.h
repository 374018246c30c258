/* eval: what `dipole eval` asks for and what it got, as its parts share it. */
#ifndef DIPOLE_CLI_EVAL_H
#define DIPOLE_CLI_EVAL_H

#include "clients/cli/channels.h"
#include "clients/cli/cli.h"
#include "clients/cli/json.h"
#include "clients/cli/parameters.h"

typedef struct cli_eval_settings {
  cli_profile_settings profile;
  cli_medium_settings medium;
  const char *table; /* a file, instead of a daemon */
  cli_texts model;
  const char *moments, *evaluator;
  cli_numbers r;
  cli_number from, to;
  cli_count count;
  bool logarithmic;
  cli_texts want;
  cli_count deadline_ms;
  cli_texts plot;
} cli_eval_settings;

enum { CLI_EVAL_QUANTITIES_MAX = 32 };

/* Of one model and channel. Single precision values are held as the doubles that they equal. */
typedef struct cli_eval_values {
  double albedo; /* NaN: not wanted */
  double numerical_error, numerical_error_per_mm;
  double model_error; /* NaN: not measured */
  /* By the position of the quantity in report->quantities: [radius_count]. */
  double *arrays[CLI_EVAL_QUANTITIES_MAX];
} cli_eval_values;

typedef struct cli_eval_model {
  const dipole_choice *choice; /* NULL: the daemon's to choose, until it has answered */
  bool named;     /* by itself, and not only as one of all: then its refusal is a failure */
  unsigned notes; /* ids of the daemon's notes */
} cli_eval_model;

/* What a tolerance has chosen from; nothing where a model was named. */
typedef struct cli_eval_offers {
  double tolerance;
  size_t count;
  dipole_offer *offers; /* cheapest first */
} cli_eval_offers;

typedef struct cli_eval_report {
  const dipole_info *info;
  const char *medium; /* name of a measured medium; NULL: none */
  const dipole_choice *evaluator, *moments;
  cli_parameters parameters; /* as given; of all models each takes what it can */
  unsigned wanted;
  size_t channel_count;
  cli_channel *channels;
  size_t model_count; /* of those that answered */
  cli_eval_model *models;
  cli_eval_offers chosen_from;
  size_t quantity_count; /* of those wanted that have a value for each radius */
  const dipole_choice *quantities[CLI_EVAL_QUANTITIES_MAX]; /* in the daemon's order */
  size_t radius_count;
  double *radii;           /* mm, as the daemon took them */
  cli_eval_values *values; /* [model_count * channel_count], model by model */
  size_t values_capacity;  /* what there is room for, and may hold arrays */
} cli_eval_report;

/* ---- eval_report.c ------------------------------------------------------------------------- */

const cli_eval_values *cli_eval_values_of(const cli_eval_report *report, size_t model,
                                          size_t channel);

/* The values of a quantity at the report's radii; NULL: not wanted. */
const double *cli_eval_array(const cli_eval_report *report, const cli_eval_values *values,
                             unsigned quantity);

/* The numerical error, relative, of the values at a radius. */
double cli_eval_numerical_error(const cli_eval_values *values, double r_mm);

/* The largest finite radius of the report; 0 when there is none. */
double cli_eval_radius_max(const cli_eval_report *report);

/* True when a model's notes hold this one of the daemon's. */
bool cli_eval_is_noted(const cli_eval_model *model, const dipole_choice *note);

void cli_eval_report_free(cli_eval_report *report);

/* ---- eval_ask.c: fills a zeroed report; says what is wrong and returns an exit status ------ */

/* Of all models those are left out, with a line each on standard error, that refuse the query. */
int cli_eval_ask(const cli_command *command, const cli_eval_settings *settings,
                 dipole_client *client, cli_eval_report *report);

/* The wanted quantities, from the names of --want; false, saying so, when the daemon lacks one. */
bool cli_eval_choose_quantities(const cli_command *command, const cli_texts *names,
                                cli_eval_report *report);

/* The radii of one query. */
typedef struct cli_eval_radii {
  unsigned spacing;
  uint64_t count;
  double start_mm, stop_mm;
  const double *f64; /* a list, in either precision; NULL: none */
  float *f32;        /* to be freed */
} cli_eval_radii;

/* None, when nothing that is wanted needs any. */
cli_eval_radii cli_eval_make_radii(const cli_eval_settings *settings,
                                   const cli_eval_report *report);

/* ---- eval_chosen.c: a tolerance instead of a model ----------------------------------------- */

bool cli_eval_is_chosen(const cli_eval_report *report);

/* "took transport by table (lut): ..."; nothing where a model was named. */
void cli_eval_write_chosen(const cli_eval_report *report, FILE *file);
void cli_eval_write_chosen_json(const cli_eval_report *report, cli_json *json);

/* ---- eval_table.c: instead of eval_ask.c, from a file and without a daemon ----------------- */

/* *info, which the report refers to, is to be freed after it. */
int cli_eval_table(const cli_command *command, const cli_eval_settings *settings,
                   cli_eval_report *report, dipole_info **info);

/* ---- eval_write.c -------------------------------------------------------------------------- */

void cli_eval_write_table(const cli_eval_report *report, FILE *file);
void cli_eval_write_csv(const cli_eval_report *report, FILE *file);
void cli_eval_write_json(const cli_eval_report *report, FILE *file);

/* ---- plot.c -------------------------------------------------------------------------------- */

/* Draws R over r into a file, whose name has been checked; an exit status. */
int cli_plot(const cli_command *command, const cli_eval_report *report, const char *path);

#endif
