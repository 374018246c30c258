#include "clients/cli/plot_report.h"

#include <math.h>
#include <string.h>

#include "clients/cli/daemon.h"

const cli_axes *cli_axes_find(const char *name) {
  static const cli_axes kinds[] = {
      {"linear", false, CLI_LINEAR},
      {"semilog", false, CLI_LOGARITHMIC},
      {"logarithmic", true, CLI_LOGARITHMIC},
      {"gamma", false, CLI_GAMMA},
      {0},
  };
  for (const cli_axes *axes = kinds; axes->name != NULL; axes++) {
    if (strcmp(axes->name, name) == 0) {
      return axes;
    }
  }
  return NULL;
}

enum { FEW_MODELS = 4, FEW_CHANNELS = CLI_PALETTE };

/* With few models and channels, one panel has all curves: each model has a dash and each channel
 * has a colour. With many of either, or with one channel, each channel has a panel and each model
 * has a colour. */
static bool is_by_channel(const cli_eval_report *report) {
  const size_t channels = report->profile.channel_count;
  return report->model_count > FEW_MODELS || channels > FEW_CHANNELS || channels == 1;
}

/* Returns the colour of a channel's curve, such as "#d62728". */
static const char *channel_colour(const cli_profile *profile, size_t channel) {
  static const char *const rgb[CLI_COLOURS] = {"#d62728", "#2ca02c", "#1f4fd8"};
  const size_t colour = cli_colour(profile->channels[channel].name);
  if (colour < CLI_COLOURS) {
    return rgb[colour];
  }
  return profile->channel_count == CLI_COLOURS ? rgb[channel] : cli_palette[channel % CLI_PALETTE];
}

/* Writes what a legend calls a channel, such as "red" or "channel 1". */
static void title_channel(const cli_profile *profile, size_t channel, char *text, size_t bytes) {
  snprintf(text, bytes, "%s%s", profile->medium != NULL ? "" : "channel ",
           profile->channels[channel].name);
}

static void add_curve(cli_picture *picture, const cli_eval_report *report, size_t k,
                      size_t quantity) {
  const size_t channels = report->profile.channel_count, model = k / channels;
  const bool by_channel = is_by_channel(report), walked = cli_is_walked(&report->models[model]);
  const char *name = report->models[model].choice->name;
  char channel[64];
  cli_curve *curve = cli_picture_add(picture);
  *curve = (cli_curve){
      .row = picture->row_count - 1,
      .column = by_channel ? k % channels : 0,
      .style = walked ? CLI_ERRORS : CLI_LINE,
      .dash = by_channel ? model / CLI_PALETTE : model,
      .mark = by_channel ? model : k,
      .colour = by_channel ? cli_palette[model % CLI_PALETTE]
                           : channel_colour(&report->profile, k % channels),
      .count = report->radius_count,
      .x = report->radii,
      .y = report->values[k].arrays[quantity],
      .error = walked ? report->values[k].arrays[quantity + 1] : NULL,
  };
  title_channel(&report->profile, k % channels, channel, sizeof channel);
  snprintf(curve->title, sizeof curve->title, "%s%s%s", name, by_channel ? "" : ", ",
           by_channel ? "" : channel);
}

/* Writes the label of the values, such as "R^(1/2.2) (R in 1/mm^2)". */
static void write_label(const cli_eval_report *report, const dipole_choice *quantity,
                        cli_row *row) {
  const bool gamma = row->axes.scale == CLI_GAMMA;
  const char *unit =
      quantity->id == DIPOLE_R && !gamma ? report->profile.info->R_unit : quantity->about;
  char power[32] = "", in[CLI_LABEL_BYTES / 2] = "";
  if (gamma) {
    snprintf(power, sizeof power, "^(1/%g)", row->gamma);
  }
  if (strcmp(unit, "1") != 0) {
    snprintf(in, sizeof in, " (%.24s%s%.48s)", gamma ? quantity->name : "", gamma ? " in " : "",
             unit);
  }
  snprintf(row->label, sizeof row->label, "%.24s%s%s", quantity->name, power, in);
}

void cli_plot_row(cli_picture *picture, const cli_eval_report *report, cli_row row,
                  size_t quantity) {
  if (row.label[0] == '\0') {
    write_label(report, report->quantities.items[quantity], &row);
  }
  picture->rows[picture->row_count++] = row;
  for (size_t k = 0; k < report->model_count * report->profile.channel_count; k++) {
    add_curve(picture, report, k, quantity);
  }
}

/* More channels than this are counted, not listed. */
enum { CAPTION_CHANNELS = 6 };

/* Returns lines with the medium of each channel, and the notes. */
static char *make_caption(const cli_eval_report *report) {
  const cli_profile *profile = &report->profile;
  char *caption = NULL, name[64];
  size_t bytes;
  unsigned notes = 0;
  FILE *lines = open_memstream(&caption, &bytes);
  if (lines == NULL) {
    return NULL;
  }
  for (size_t i = 0; i < profile->channel_count && i < CAPTION_CHANNELS; i++) {
    const dipole_medium *medium = &profile->channels[i].medium;
    title_channel(profile, i, name, sizeof name);
    fprintf(lines, "%s: sigma_a %.6g/mm, sigma_s %.6g/mm, g %.6g, eta %.6g\n", name,
            medium->sigma_a_per_mm, medium->sigma_s_per_mm, medium->g, medium->eta);
  }
  if (profile->channel_count > CAPTION_CHANNELS) {
    fprintf(lines, "and %zu more\n", profile->channel_count - CAPTION_CHANNELS);
  }
  for (size_t i = 0; i < report->model_count; i++) {
    notes |= report->models[i].notes;
  }
  cli_write_notes(profile->info, notes, lines);
  fclose(lines);
  return caption;
}

int cli_plot_report(cli_picture *picture, const cli_eval_report *report, const cli_texts *paths) {
  const cli_profile *profile = &report->profile;
  const bool by_f = cli_eval_is_by_f(report), by_channel = is_by_channel(report);
  snprintf(picture->title, sizeof picture->title, "%s",
           profile->medium != NULL ? profile->medium
           : by_f                  ? "R_f(f)"
                                   : "R(r)");
  picture->x_label = by_f ? "f (1/mm)" : "r (mm)";
  picture->column_count = by_channel ? profile->channel_count : 1;
  picture->columns = cli_allocate(picture->column_count, sizeof *picture->columns);
  for (size_t i = 0; by_channel && i < profile->channel_count; i++) {
    title_channel(profile, i, picture->columns[i], sizeof picture->columns[i]);
  }
  picture->caption = make_caption(report);
  return cli_picture_draw(picture, paths);
}

/* Returns whether the ratios between radii are equal, so that a logarithmic axis spreads them
 * evenly. */
static bool has_equal_ratios(const cli_eval_report *report) {
  const double *r = report->radii;
  const size_t n = report->radius_count;
  return n > 2 && r[0] > 0 && isfinite(r[n - 1]) && r[n - 1] > r[0] &&
         fabs(r[1] / r[0] / (r[n - 1] / r[n - 2]) - 1) < 1e-3;
}

int cli_plot_R(const cli_eval_report *report, const cli_texts *paths) {
  cli_picture picture = {0};
  const char *axes = has_equal_ratios(report) ? "logarithmic" : "semilog";
  size_t quantity = 0;
  while (report->quantities.items[quantity]->id != DIPOLE_R) {
    quantity++;
  }
  cli_plot_row(&picture, report, (cli_row){.axes = *cli_axes_find(axes)}, quantity);
  return cli_plot_report(&picture, report, paths);
}
