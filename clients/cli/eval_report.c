#include "clients/cli/eval_report.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>

const dipole_choice cli_monte_carlo = {.kind = DIPOLE_MODEL, .name = "mc", .about = "Monte Carlo"};

bool cli_is_walked(const cli_eval_model *model) {
  return model->choice == &cli_monte_carlo;
}

bool cli_eval_is_by_f(const cli_eval_report *report) {
  return (report->quantities.wanted & ~(unsigned)(DIPOLE_ALBEDO | DIPOLE_RADIUS)) ==
         DIPOLE_TRANSFER;
}

void cli_eval_add_model(cli_eval_report *report, const dipole_choice *model, bool named) {
  for (size_t i = 0; i < report->model_count; i++) {
    if (report->models[i].choice == model) {
      report->models[i].named |= named;
      return;
    }
  }
  report->models = cli_resize(report->models, report->model_count + 1, sizeof *report->models);
  report->models[report->model_count++] = (cli_eval_model){.choice = model, .named = named};
}

void cli_eval_make_values(cli_eval_report *report) {
  report->values_capacity = report->model_count * report->profile.channel_count;
  report->values = cli_allocate(report->values_capacity, sizeof *report->values);
}

const cli_eval_values *cli_eval_values_of(const cli_eval_report *report, size_t model,
                                          size_t channel) {
  return &report->values[model * report->profile.channel_count + channel];
}

size_t cli_eval_add_quantity(cli_eval_report *report, const dipole_choice *quantity) {
  const size_t at = report->quantities.count++;
  assert(at < CLI_QUANTITIES_MAX);
  report->quantities.items[at] = quantity;
  for (size_t k = 0; k < report->model_count * report->profile.channel_count; k++) {
    report->values[k].arrays[at] = cli_allocate(report->radius_count, sizeof(double));
    for (size_t i = 0; i < report->radius_count; i++) {
      report->values[k].arrays[at][i] = (double)NAN;
    }
  }
  return at;
}

void cli_eval_report_free(cli_eval_report *report) {
  for (size_t i = 0; i < report->values_capacity; i++) {
    for (size_t q = 0; q < report->quantities.count; q++) {
      free(report->values[i].arrays[q]);
    }
  }
  free(report->values);
  free(report->chosen_from.offers);
  free(report->radii);
  free(report->models);
  cli_profile_free(&report->profile);
}
