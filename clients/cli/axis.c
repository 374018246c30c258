#include "clients/cli/axis.h"

#include <math.h>

double cli_axis_place(const cli_axis *axis, double value) {
  if (axis->logarithmic) {
    return (log10(value) - log10(axis->low)) / (log10(axis->high) - log10(axis->low));
  }
  return (value - axis->low) / (axis->high - axis->low);
}

/* What rounding may take from an end. */
#define SLACK 1e-9

/* Multiples of a step that lie between two numbers: the first, and how many there are. */
static size_t count_multiples(double low, double high, double step, double *first) {
  *first = ceil(low / step - SLACK);
  const double last = floor(high / step + SLACK);
  return last >= *first ? (size_t)(last - *first) + 1 : 0;
}

/* The multiples of 1, 2 or 5 times a power of ten, as many as allowed, or two at least. */
static size_t linear_ticks(double low, double high, size_t most, double *ticks) {
  static const double steps[] = {1, 2, 5, 10, 20};
  const double decade = pow(10, floor(log10((high - low) / (double)most)));
  size_t count = most + 1;
  double first = 0, step = 0;
  for (size_t i = 0; count > most && i < sizeof steps / sizeof steps[0]; i++) {
    step = steps[i] * decade;
    count = count_multiples(low, high, step, &first);
  }
  for (size_t i = 0; i < count; i++) {
    ticks[i] = (first + (double)i) * step;
  }
  return count;
}

size_t cli_axis_ticks(const cli_axis *axis, size_t most, double ticks[CLI_AXIS_TICKS_MAX]) {
  const double low = axis->logarithmic ? log10(axis->low) : axis->low;
  const double high = axis->logarithmic ? log10(axis->high) : axis->high;
  if (!axis->logarithmic || high - low < 1) {
    return linear_ticks(axis->low, axis->high, most, ticks);
  }
  double first, step = 1;
  size_t count = count_multiples(low, high, step, &first);
  while (count > most) {
    step++;
    count = count_multiples(low, high, step, &first);
  }
  for (size_t i = 0; i < count; i++) {
    ticks[i] = pow(10, (first + (double)i) * step);
  }
  return count;
}
