/* What is read from the report of `dipole eval`. */
#include <math.h>
#include <stdlib.h>

#include "clients/cli/eval.h"

const cli_eval_values *cli_eval_values_of(const cli_eval_report *report, size_t model,
                                          size_t channel) {
  return &report->values[model * report->channel_count + channel];
}

const double *cli_eval_array(const cli_eval_report *report, const cli_eval_values *values,
                             unsigned quantity) {
  for (size_t q = 0; q < report->quantity_count; q++) {
    if (report->quantities[q]->id == quantity) {
      return values->arrays[q];
    }
  }
  return NULL;
}

double cli_eval_numerical_error(const cli_eval_values *values, double r_mm) {
  /* 0 times infinity is not a number, but a rate of 0 adds nothing at any radius. */
  return values->numerical_error +
         (values->numerical_error_per_mm > 0 ? values->numerical_error_per_mm * r_mm : 0);
}

double cli_eval_radius_max(const cli_eval_report *report) {
  double max = 0;
  for (size_t i = 0; i < report->radius_count; i++) {
    if (isfinite(report->radii[i]) && report->radii[i] > max) {
      max = report->radii[i];
    }
  }
  return max;
}

bool cli_eval_is_noted(const cli_eval_model *model, const dipole_choice *note) {
  return cli_is_noted(model->notes, note);
}

void cli_eval_report_free(cli_eval_report *report) {
  for (size_t i = 0; i < report->values_capacity; i++) {
    for (size_t q = 0; q < report->quantity_count; q++) {
      free(report->values[i].arrays[q]);
    }
  }
  free(report->values);
  free(report->chosen_from.offers);
  free(report->radii);
  free(report->models);
  free(report->channels);
}
