#include "clients/cli/plot_derive.h"

#include <assert.h>
#include <math.h>
#include <string.h>

#include "clients/cli/number.h"

/* Room for a quantity's values, of all models and channels. */
static size_t add_quantity(cli_eval_report *report, plot_derived *derived) {
  const size_t at = report->quantity_count;
  assert(at < CLI_EVAL_QUANTITIES_MAX);
  derived->choice =
      (dipole_choice){.kind = DIPOLE_QUANTITY, .name = derived->name, .about = derived->about};
  report->quantities[report->quantity_count++] = &derived->choice;
  for (size_t i = 0; i < report->model_count * report->channel_count; i++) {
    report->values[i].arrays[at] = cli_allocate(report->radius_count, sizeof(double));
  }
  return at;
}

size_t plot_add_gamma(cli_eval_report *report, size_t quantity, double gamma,
                      plot_derived *derived) {
  const dipole_choice *of = report->quantities[quantity];
  char number[CLI_NUMBER_BYTES];
  snprintf(derived->name, sizeof derived->name, "%.24s^(1/%s)", of->name,
           cli_number_format(gamma, number));
  snprintf(derived->about, sizeof derived->about, "%.24s%s%.48s", of->name,
           strcmp(of->about, "1") == 0 ? "" : " in ", strcmp(of->about, "1") == 0 ? "" : of->about);
  const size_t at = add_quantity(report, derived);
  for (size_t k = 0; k < report->model_count * report->channel_count; k++) {
    cli_eval_values *values = &report->values[k];
    for (size_t i = 0; i < report->radius_count; i++) {
      const double value = values->arrays[quantity][i];
      values->arrays[at][i] = value >= 0 ? pow(value, 1 / gamma) : (double)NAN;
    }
  }
  return at;
}

static double deviation(double value, double from) {
  return isfinite(value) && isfinite(from) && from != 0 ? value / from - 1 : (double)NAN;
}

size_t plot_add_deviation(cli_eval_report *report, size_t quantity, size_t reference,
                          plot_derived *derived) {
  snprintf(derived->name, sizeof derived->name, "deviation");
  snprintf(derived->about, sizeof derived->about, "relative, from %.64s",
           report->models[reference].choice->name);
  const size_t at = add_quantity(report, derived);
  for (size_t k = 0; k < report->model_count * report->channel_count; k++) {
    const cli_eval_values *from = cli_eval_values_of(report, reference, k % report->channel_count);
    for (size_t i = 0; i < report->radius_count; i++) {
      report->values[k].arrays[at][i] =
          deviation(report->values[k].arrays[quantity][i], from->arrays[quantity][i]);
    }
  }
  return at;
}
