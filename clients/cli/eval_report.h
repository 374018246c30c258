/* eval_report: what `dipole eval` and `dipole plot` get from a daemon or from tables. */
#ifndef DIPOLE_CLI_EVAL_REPORT_H
#define DIPOLE_CLI_EVAL_REPORT_H

#include "clients/cli/profile.h"

/* The values of one model and channel. Single precision values are held as the doubles that they
 * equal. */
typedef struct cli_eval_values {
  double albedo; /* NaN if it is not wanted */
  double numerical_error, numerical_error_per_mm;
  double model_error;                 /* NaN if it is not known */
  double *arrays[CLI_QUANTITIES_MAX]; /* [radius_count] for each of the report's quantities */
} cli_eval_values;

typedef struct cli_eval_model {
  const dipole_choice *choice;    /* NULL until the daemon has chosen it; or cli_monte_carlo */
  const dipole_choice *evaluator; /* NULL for cli_monte_carlo */
  bool named;     /* on the command line, and not only as one of all: its refusal is a failure */
  bool unlisted;  /* asked for as the reference only; it is then the last model */
  unsigned notes; /* ids of the daemon's notes */
} cli_eval_model;

/* What a tolerance has chosen from; all 0 if a model was named. */
typedef struct cli_eval_offers {
  double tolerance;
  size_t count;
  dipole_offer *offers; /* cheapest first */
} cli_eval_offers;

typedef struct cli_eval_report {
  cli_profile
      profile; /* `model` and `evaluator` are not used; each model takes what it can of the parameters */
  cli_quantities quantities;
  size_t model_count; /* how many models answered */
  cli_eval_model *models;
  cli_eval_offers chosen_from;
  size_t radius_count;
  double *radii;           /* the radii in mm, as the daemon used them */
  cli_eval_values *values; /* [model_count * channel_count], model by model */
  size_t values_capacity;  /* how many values have room, and may hold arrays */
} cli_eval_report;

/* What stands in place of a model for means over rings by Monte Carlo. */
extern const dipole_choice cli_monte_carlo;

/* Adds a model, or notes that it is named if it is there already. */
void cli_eval_add_model(cli_eval_report *report, const dipole_choice *model, bool named);

/* Returns whether R_f is the only quantity at the report's radii, which are then spatial frequencies
 * f in 1/mm. */
bool cli_eval_is_by_f(const cli_eval_report *report);

/* Returns whether the values of a model are those of Monte Carlo, which have standard errors. */
bool cli_is_walked(const cli_eval_model *model);

/* Makes room for the values of all models and channels. */
void cli_eval_make_values(cli_eval_report *report);

const cli_eval_values *cli_eval_values_of(const cli_eval_report *report, size_t model,
                                          size_t channel);

/* Adds a quantity, whose values are NaN. Returns its position. */
size_t cli_eval_add_quantity(cli_eval_report *report, const dipole_choice *quantity);

void cli_eval_report_free(cli_eval_report *report);

#endif
