#include "clients/cli/picture_parts.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

static const char *const palette[] = {"#000000", "#e69f00", "#56b4e9", "#009e73",
                                      "#cc79a7", "#d55e00", "#0072b2", "#999999"};

enum { PALETTE = sizeof palette / sizeof palette[0] };

/* ---- curves -------------------------------------------------------------------------------- */

enum { FEW_MODELS = 4, FEW_CHANNELS = PALETTE };

picture_layout picture_layout_of(const cli_eval_report *report) {
  const size_t models = report->model_count, channels = report->channel_count;
  if (models > FEW_MODELS || channels > FEW_CHANNELS || channels == 1) {
    return (picture_layout){.by_channel = true, .panels = channels, .curves = models};
  }
  return (picture_layout){.panels = 1, .curves = models * channels};
}

static void channel_title(const cli_eval_report *report, size_t channel,
                          char text[PICTURE_TEXT_BYTES]) {
  snprintf(text, PICTURE_TEXT_BYTES, "%s%s", report->medium != NULL ? "" : "channel ",
           report->channels[channel].name);
}

static const char *channel_colour(const cli_eval_report *report, size_t channel) {
  static const char *const rgb[][2] = {
      {"red", "#d62728"}, {"green", "#2ca02c"}, {"blue", "#1f4fd8"}};
  for (size_t i = 0; i < sizeof rgb / sizeof rgb[0]; i++) {
    if (strcmp(report->channels[channel].name, rgb[i][0]) == 0) {
      return rgb[i][1];
    }
  }
  return report->channel_count == 3 ? rgb[channel][1] : palette[channel % PALETTE];
}

picture_curve picture_curve_of(const cli_eval_report *report, size_t panel, size_t index) {
  char channel[PICTURE_TEXT_BYTES];
  picture_curve curve = {.model = index, .channel = panel};
  if (picture_layout_of(report).by_channel) {
    curve.dash = 1 + index / PALETTE;
    curve.colour = palette[index % PALETTE];
    snprintf(curve.title, sizeof curve.title, "%s", report->models[index].choice->name);
    return curve;
  }
  curve.model = index / report->channel_count;
  curve.channel = index % report->channel_count;
  curve.dash = 1 + curve.model;
  curve.colour = channel_colour(report, curve.channel);
  channel_title(report, curve.channel, channel);
  snprintf(curve.title, sizeof curve.title, "%.64s, %.64s",
           report->models[curve.model].choice->name, channel);
  return curve;
}

/* ---- texts --------------------------------------------------------------------------------- */

static const dipole_choice *quantity_of(const cli_picture *picture, size_t row) {
  return picture->report->quantities[picture->rows[row].quantity];
}

const char *picture_title(const cli_picture *picture, char text[PICTURE_TEXT_BYTES]) {
  if (picture->report->medium != NULL) {
    snprintf(text, PICTURE_TEXT_BYTES, "%s", picture->report->medium);
  } else {
    snprintf(text, PICTURE_TEXT_BYTES, "%s(r)", quantity_of(picture, 0)->name);
  }
  return text;
}

const char *picture_panel_title(const cli_picture *picture, size_t panel,
                                char text[PICTURE_TEXT_BYTES]) {
  text[0] = '\0';
  if (picture_layout_of(picture->report).by_channel) {
    channel_title(picture->report, panel, text);
  }
  return text;
}

const char *picture_value_label(const cli_picture *picture, size_t row,
                                char text[PICTURE_TEXT_BYTES]) {
  const dipole_choice *quantity = quantity_of(picture, row);
  const char *unit = quantity->id == DIPOLE_R ? picture->report->info->R_unit : quantity->about;
  if (picture->rows[row].label != NULL) {
    snprintf(text, PICTURE_TEXT_BYTES, "%s", picture->rows[row].label);
  } else if (strcmp(unit, "1") == 0) {
    snprintf(text, PICTURE_TEXT_BYTES, "%s", quantity->name);
  } else {
    snprintf(text, PICTURE_TEXT_BYTES, "%s (%s)", quantity->name, unit);
  }
  return text;
}

/* ---- values -------------------------------------------------------------------------------- */

double picture_shown(const cli_picture *picture, size_t row, const picture_curve *curve,
                     size_t radius) {
  const cli_eval_report *report = picture->report;
  const cli_axes *axes = &picture->rows[row].axes;
  const cli_eval_values *values = cli_eval_values_of(report, curve->model, curve->channel);
  const double r_mm = report->radii[radius];
  const double value = values->arrays[picture->rows[row].quantity][radius];
  if (!isfinite(r_mm) || !isfinite(value) || (axes->logarithmic_r && r_mm <= 0) ||
      (axes->scale == CLI_LOGARITHMIC && value <= 0)) {
    return (double)NAN;
  }
  return axes->scale == CLI_PERCENT ? 100 * value : value;
}

/* The least and largest of what is shown at radii from r_mm on; low > high: there is none. */
static picture_range extent(const cli_picture *picture, size_t row, const picture_curve *curve,
                            double r_mm) {
  picture_range range = {(double)INFINITY, -(double)INFINITY};
  for (size_t i = 0; i < picture->report->radius_count; i++) {
    const double shown = picture_shown(picture, row, curve, i);
    if (!isnan(shown) && picture->report->radii[i] >= r_mm) {
      range.low = fmin(range.low, shown);
      range.high = fmax(range.high, shown);
    }
  }
  return range;
}

/* ---- ranges -------------------------------------------------------------------------------- */

/* The radii at which a row shows anything. */
static picture_range r_extent(const cli_picture *picture, size_t row) {
  const cli_eval_report *report = picture->report;
  const picture_layout layout = picture_layout_of(report);
  picture_range range = {(double)INFINITY, -(double)INFINITY};
  for (size_t c = 0; c < layout.panels * layout.curves; c++) {
    const picture_curve curve = picture_curve_of(report, c / layout.curves, c % layout.curves);
    for (size_t i = 0; i < report->radius_count; i++) {
      if (!isnan(picture_shown(picture, row, &curve, i))) {
        range.low = fmin(range.low, report->radii[i]);
        range.high = fmax(range.high, report->radii[i]);
      }
    }
  }
  return range;
}

/* Less of an axis than this before its first radius is shown too, so that the axis starts at 0. */
#define TO_ZERO_SHARE 0.1

static picture_range r_range(picture_range extent_mm, bool logarithmic) {
  picture_range range = extent_mm;
  if (!logarithmic && range.low < TO_ZERO_SHARE * range.high) {
    range.low = 0;
  }
  if (range.low < range.high) {
    return range;
  }
  /* A single radius. */
  if (logarithmic) {
    return (picture_range){range.low / 2, range.high * 2};
  }
  return (picture_range){0, range.high > 0 ? 2 * range.high : 1};
}

static int compare(const void *a, const void *b) {
  const double x = *(const double *)a, y = *(const double *)b;
  return (x > y) - (x < y);
}

/* Decades below the least value of the middle curve: some models fall off so much faster than
 * others that an axis for all of a curve shows nothing of the rest. */
enum { TAIL_DECADES = 4 };

static picture_range logarithmic_range(const picture_range *extents, size_t count, double most) {
  double *least = cli_allocate(count, sizeof *least);
  for (size_t c = 0; c < count; c++) {
    least[c] = extents[c].low;
  }
  qsort(least, count, sizeof *least, compare);
  const double tail = fmax(floor(log10(least[0])), floor(log10(least[count / 2])) - TAIL_DECADES);
  const double low = fmax(tail, DBL_MIN_10_EXP);
  const double high = fmin(fmax(ceil(log10(most)), low + 1), DBL_MAX_10_EXP);
  free(least);
  return (picture_range){pow(10, low), pow(10, high)};
}

/* A deviation by more than this, in percent, is beyond the axis. */
#define PERCENT_MAX 200.0

/* Room beyond the curves. */
#define ROOM 0.05

static picture_range linear_range(picture_range all, enum cli_scale scale) {
  if (scale == CLI_PERCENT) {
    all.low = fmin(fmax(all.low, -PERCENT_MAX), 0);
    all.high = fmax(fmin(all.high, PERCENT_MAX), 0);
  }
  if (scale == CLI_GAMMA || (scale == CLI_LINEAR && all.low >= 0)) {
    return (picture_range){0, all.high > 0 ? (1 + ROOM) * all.high : 1};
  }
  const double room = all.low < all.high ? ROOM * (all.high - all.low) : 1;
  return (picture_range){all.low - room, all.high + room};
}

/* Near r = 0 some quantities rise without bound: where a curve does, so that this share of the
 * radii has more than so many times what all others have, it leaves a linear axis. */
#define PEAK_SHARE 0.02
#define PEAK_RATIO 4.0

/* An end of a linear axis, of the curves without their peaks and with them. */
static double end_of(double inner, double whole) {
  return fabs(whole) <= PEAK_RATIO * fabs(inner) ? whole : inner;
}

/* The extent of all curves from a radius on, and of each that is there; the number of these. */
static size_t extents_from(const cli_picture *picture, size_t row, double r_mm, picture_range *each,
                           picture_range *all) {
  const picture_layout layout = picture_layout_of(picture->report);
  size_t count = 0;
  *all = (picture_range){(double)INFINITY, -(double)INFINITY};
  for (size_t c = 0; c < layout.panels * layout.curves; c++) {
    const picture_curve curve =
        picture_curve_of(picture->report, c / layout.curves, c % layout.curves);
    const picture_range one = extent(picture, row, &curve, r_mm);
    if (one.low <= one.high) {
      each[count++] = one;
      all->low = fmin(all->low, one.low);
      all->high = fmax(all->high, one.high);
    }
  }
  return count;
}

bool picture_ranges(const cli_picture *picture, size_t row, picture_range *r,
                    picture_range *value) {
  const cli_axes *axes = &picture->rows[row].axes;
  const picture_layout layout = picture_layout_of(picture->report);
  const picture_range r_mm = r_extent(picture, row);
  if (r_mm.low > r_mm.high) {
    return false;
  }
  picture_range inner, whole;
  picture_range *each = cli_allocate(layout.panels * layout.curves, sizeof *each);
  const double inner_mm = r_mm.low + PEAK_SHARE * (r_mm.high - r_mm.low);
  extents_from(picture, row, inner_mm, each, &inner);
  const size_t count = extents_from(picture, row, r_mm.low, each, &whole);
  *r = r_range(r_mm, axes->logarithmic_r);
  if (axes->scale == CLI_LOGARITHMIC) {
    *value = logarithmic_range(each, count, whole.high);
  } else if (axes->scale == CLI_PERCENT) {
    *value = linear_range(whole, axes->scale);
  } else {
    *value = linear_range(
        (picture_range){end_of(inner.low, whole.low), end_of(inner.high, whole.high)}, axes->scale);
  }
  free(each);
  return true;
}
