#include "clients/cli/profile.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/options.h"
#include "core/core.h"
#include "proto/decimal.h"

#define G_DEFAULT 0.0
#define ETA_DEFAULT 1.3

const cli_option cli_medium_options[] = {
    CLI_TITLE("Medium"),
    CLI_OPTION(NAMES, medium, NULL,
               "media by name: red, green and blue of each; `dipole media` lists them"),
    CLI_OPTION(NAMES, channel, NULL,
               "red, green or blue. Only these channels are taken (default: all)"),
    CLI_OPTION(NUMBERS, sigma_a, NULL, "absorption coefficient, 1/mm; one value for each channel"),
    CLI_OPTION(NUMBERS, sigma_s, NULL,
               "scattering coefficient, 1/mm; a single value is for all channels"),
    CLI_OPTION(NUMBERS, g, NULL,
               "mean cosine of the scattering angle (default: 0); sigma_s (1 - g) of a measured "
               "medium stays as it was measured"),
    CLI_OPTION(
        NUMBERS, eta, NULL,
        "refractive index inside over outside (default: that of the measured medium, else 1.3)"),
    {0},
};

const cli_option cli_layer_options[] = {
    CLI_OPTION(NUMBERS, thickness, NULL,
               "of a slab, mm (default: a half space); transport, multipoles and mc take slabs"),
    {"layer",
     "in place of all this: a layer of a stack, from the top down; repeat it for each. A last one "
     "without thickness (mm) is a half space. transport and mc take stacks",
     CLI_FILES, offsetof(cli_settings, layer), NULL, "SIGMA_A,SIGMA_S,G,ETA[,THICKNESS]"},
    CLI_TISSUE_OPTIONS,
    {0},
};

const char *cli_usual_evaluator(const cli_settings *settings, const char *model) {
  const cli_given *tolerance = &settings->parameters[CORE_PARAMETER_TOLERANCE];
  const bool tabled = tolerance->text == NULL || tolerance->value >= CORE_LUT_TOLERANCE_MIN;
  return tabled && (model == NULL || strcmp(model, CLI_MODEL_DEFAULT) == 0) ? "lut" : "f64";
}

/* ---- colours and lengths --------------------------------------------------------------------- */

double cli_srgb_to_linear(double value) {
  return value <= 0.04045 ? value / 12.92 : pow((value + 0.055) / 1.055, 2.4);
}

const cli_numbers *cli_lengths_find(const cli_settings *settings, const char **name) {
  const cli_numbers *found = NULL, *const lengths[] = {&settings->mean_free_path,
                                                       &settings->diffuse_mean_free_path,
                                                       &settings->classical_diffuse_path,
                                                       &settings->extinction_path};
  size_t given = 0;
  for (size_t i = 0; i < sizeof lengths / sizeof lengths[0]; i++) {
    if (lengths[i]->count > 0) {
      found = lengths[i];
      *name = core_lengths[i].name;
      given++;
    }
  }
  if (given != 1) {
    cli_fail_usage("give exactly one of --mean-free-path, --diffuse-mean-free-path, "
                   "--classical-diffuse-path and --extinction-path");
  }
  return given == 1 && !isnan(cli_unit_mm(settings)) ? found : NULL;
}

double cli_unit_mm(const cli_settings *settings) {
  const char *unit = settings->unit != NULL ? settings->unit : "mm";
  char *end = "";
  const double value = strcmp(unit, "mm") == 0   ? 1
                       : strcmp(unit, "cm") == 0 ? 10
                       : strcmp(unit, "m") == 0  ? 1000
                                                 : strtod(unit, &end);
  if (*end == '\0' && value > 0 && value < INFINITY) {
    return value;
  }
  cli_fail_usage("--unit: mm, cm, m, or a number of millimetres");
  return NAN;
}

/* ---- parameters ------------------------------------------------------------------------------ */

bool cli_parameters_remove(cli_parameters *parameters, unsigned id) {
  for (size_t i = 0; i < parameters->count; i++) {
    if (parameters->items[i].id == id) {
      parameters->items[i] = parameters->items[--parameters->count];
      return true;
    }
  }
  return false;
}

void cli_parameters_set(cli_parameters *parameters, unsigned id, double value) {
  cli_parameters_remove(parameters, id);
  if (parameters->count < CLI_PARAMETERS_MAX) {
    parameters->items[parameters->count++] = (dipole_parameter){id, value};
  }
}

/* Returns the kind of list whose names a parameter takes. */
static enum dipole_kind kind_of(const dipole_choice *parameter) {
  return strcmp(parameter->name, "phase") == 0 ? DIPOLE_PHASE : DIPOLE_MODEL;
}

/* Returns whether its values are names, and not numbers. */
static bool is_named(const dipole_choice *parameter) {
  return strncmp(parameter->about, "id: ", strlen("id: ")) == 0;
}

bool cli_parameter_parse(const dipole_info *info, const dipole_choice *parameter, const char *text,
                         double *value) {
  const dipole_choice *choice =
      is_named(parameter) ? cli_choice(info, kind_of(parameter), text) : NULL;
  if (choice != NULL) {
    *value = choice->id;
  }
  return choice != NULL || decimal_read(text, value);
}

static bool take_parameter(const dipole_info *info, const cli_given *given, unsigned id,
                           cli_parameters *parameters) {
  char known[1024];
  const char *name = core_choice_by_id(core_parameter_list, id)->name;
  const dipole_choice *parameter = cli_choice(info, DIPOLE_PARAMETER, name);
  const cli_option *option = cli_options_find(name);
  double value;
  if (parameter == NULL) {
    cli_list_names(info, DIPOLE_PARAMETER, known, sizeof known);
    return cli_fails_usage("--%s: this daemon does not know it; it knows %s", option->name, known);
  }
  if (!cli_parameter_parse(info, parameter, given->text, &value)) {
    return cli_named(info, kind_of(parameter), option->name, given->text) != NULL;
  }
  cli_parameters_set(parameters, parameter->id, value);
  return true;
}

static bool take_parameters(const dipole_info *info, const cli_settings *settings,
                            cli_parameters *parameters) {
  bool good = true;
  *parameters = (cli_parameters){0};
  for (unsigned id = 1; good && id < CORE_PARAMETERS_END; id++) {
    const cli_given *given = &settings->parameters[id];
    good = given->text == NULL || take_parameter(info, given, id, parameters);
  }
  return good;
}

/* ---- the medium's options -------------------------------------------------------------------- */

const char *const cli_colours[CLI_COLOURS] = {"red", "green", "blue"};

bool cli_medium_given(const cli_settings *settings) {
  return settings->medium.count > 0 || settings->channel.count > 0 || settings->sigma_a.count > 0 ||
         settings->sigma_s.count > 0 || settings->g.count > 0 || settings->eta.count > 0 ||
         settings->thickness.count > 0 || settings->layer.count > 0;
}

bool cli_layer_read(const char *text, dipole_medium *layer) {
  double numbers[5] = {0};
  size_t count = 0;
  for (char *rest = cli_copy(text, strlen(text)), *one; (one = strsep(&rest, ",")) != NULL;) {
    if (count == 5 || !decimal_read(one, &numbers[count++])) {
      return false;
    }
  }
  *layer = (dipole_medium){numbers[0], numbers[1], numbers[2], numbers[3], numbers[4]};
  return count >= 4;
}

static int check_layers(const cli_settings *settings) {
  const cli_texts *layers = &settings->layer;
  if (settings->medium.count + settings->channel.count + settings->sigma_a.count +
          settings->sigma_s.count + settings->g.count + settings->eta.count +
          settings->thickness.count >
      0) {
    return cli_fail_usage("--layer gives a layer whole: leave --medium, --channel, --sigma-a, "
                          "--sigma-s, --g, --eta and --thickness out");
  }
  if (layers->count > CORE_LAYERS_MAX) {
    return cli_fail_usage("--layer: %zu layers: give at most %d", layers->count, CORE_LAYERS_MAX);
  }
  for (size_t i = 0; i < layers->count; i++) {
    dipole_medium layer;
    if (!cli_layer_read(layers->items[i], &layer)) {
      return cli_fail_usage("--layer %s: give SIGMA_A,SIGMA_S,G,ETA, and the thickness in mm of a "
                            "layer that is no half space",
                            layers->items[i]);
    }
    if (i + 1 < layers->count && layer.thickness_mm == 0) {
      return cli_fail_usage(
          "--layer %s: only the last layer may be a half space: add its thickness in mm",
          layers->items[i]);
    }
  }
  return CLI_OK;
}

/* Lists the colours of measured media that are requested; all are if none is named. */
static size_t list_colours(const cli_settings *settings, size_t colours[CLI_COLOURS]) {
  size_t count = 0;
  for (size_t i = 0; i < CLI_COLOURS; i++) {
    if (settings->channel.count == 0 || cli_texts_have(&settings->channel, cli_colours[i])) {
      colours[count++] = i;
    }
  }
  return count;
}

size_t cli_colour(const char *name) {
  size_t i = 0;
  while (i < CLI_COLOURS && (name == NULL || strcmp(cli_colours[i], name) != 0)) {
    i++;
  }
  return i;
}

int cli_medium_check(const cli_settings *settings) {
  const int of_tissue = cli_tissue_check(settings);
  if (settings->tissue.count > 0 || of_tissue != CLI_OK) {
    return of_tissue;
  }
  if (settings->layer.count > 0) {
    return check_layers(settings);
  }
  if (settings->medium.count == 0 &&
      (settings->sigma_a.count == 0 || settings->sigma_s.count == 0)) {
    return cli_fail_usage("give --medium NAME, or --sigma-a and --sigma-s%s",
                          cli_options_find("layer") != NULL ? ", or --layer" : "");
  }
  if (settings->medium.count > 0 && (settings->sigma_a.count > 0 || settings->sigma_s.count > 0)) {
    return cli_fail_usage("--medium NAME stands for --sigma-a and --sigma-s: leave these out; --g "
                          "and --eta may stay");
  }
  if (settings->medium.count == 0 && settings->channel.count > 0) {
    return cli_fail_usage("--channel is one of a measured medium: give --medium too");
  }
  for (size_t i = 0; i < settings->channel.count; i++) {
    if (cli_colour(settings->channel.items[i]) == CLI_COLOURS) {
      return cli_fail_usage("--channel: '%s' is unknown; it is red, green or blue",
                            settings->channel.items[i]);
    }
  }
  return CLI_OK;
}

/* ---- media ----------------------------------------------------------------------------------- */

static int fail_unknown_medium(const char *name, const dipole_measured_medium *media,
                               size_t count) {
  char known[1024] = "";
  size_t length = 0;
  for (size_t i = 0; i < count && length < sizeof known; i++) {
    length += (size_t)snprintf(known + length, sizeof known - length, "%s%s", i > 0 ? ", " : "",
                               media[i].name);
  }
  return cli_fail_usage("--medium: '%s' is unknown; this daemon has %s", name, known);
}

/* Sets the medium of a channel: that of the options, or a colour of a measured half space, whose
 * reduced scattering coefficient stays. */
static void set_medium(const cli_settings *settings, size_t i, const dipole_medium *measured,
                       dipole_medium *medium) {
  *medium = measured != NULL ? *measured
                             : (dipole_medium){cli_numbers_pick(&settings->sigma_a, i, 0),
                                               cli_numbers_pick(&settings->sigma_s, i, 0),
                                               G_DEFAULT, ETA_DEFAULT};
  const double g = cli_numbers_pick(&settings->g, i, medium->g);
  medium->sigma_s_per_mm *= measured != NULL ? (1 - medium->g) / (1 - g) : 1;
  medium->g = g;
  medium->eta = cli_numbers_pick(&settings->eta, i, medium->eta);
  medium->thickness_mm = cli_numbers_pick(&settings->thickness, i, 0);
}

/* Sets the channels of the media with names. The name of a channel is its colour, behind the name of
 * the medium if there are several. */
static int take_named(const cli_settings *settings, const dipole_measured_medium *known,
                      size_t known_count, cli_profile *profile) {
  const cli_texts *names = &settings->medium;
  size_t colours[CLI_COLOURS];
  const size_t each = list_colours(settings, colours), count = profile->channel_count;
  for (size_t i = 0; i < count; i++) {
    const char *name = names->items[i / each];
    const dipole_measured_medium *one = known;
    while (one < known + known_count && strcmp(one->name, name) != 0) {
      one++;
    }
    if (one == known + known_count) {
      return fail_unknown_medium(name, known, known_count);
    }
    const uint32_t layers = one->layer_count;
    if (i == 0) {
      cli_profile_set_channels(profile, count, layers);
    } else if (profile->layer_count != layers) {
      return cli_fail_usage("--medium: %s and %s differ in the number of layers: take one command "
                            "for each",
                            names->items[0], name);
    }
    if (layers > 1 && cli_options_find("layer") == NULL) {
      return cli_fail_usage("--medium %s has layers: this command takes half spaces", name);
    }
    if (layers > 1 && settings->g.count + settings->eta.count + settings->thickness.count > 0) {
      return cli_fail_usage("--medium %s has layers: leave --g, --eta and --thickness out", name);
    }
    const dipole_medium *from = &one->channel[colours[i % each] * layers];
    dipole_medium *to = &profile->media[i * layers];
    memcpy(to, from, layers * sizeof *to);
    if (layers == 1) {
      set_medium(settings, i, from, to);
    }
    snprintf(profile->names[i], CLI_CHANNEL_BYTES, "%s%s%s", names->count > 1 ? name : "",
             names->count > 1 ? " " : "", cli_colours[colours[i % each]]);
  }
  return CLI_OK;
}

/* Sets the media of all channels. The name of one that has none is its number. */
static int take_media(const cli_settings *settings, dipole_client *client, size_t count,
                      cli_profile *profile) {
  const size_t layers = settings->layer.count;
  dipole_measured_medium *known;
  dipole_error error;
  size_t known_count;
  profile->medium = settings->medium.whole;
  profile->channel_count = count;
  if (settings->medium.count > 0) {
    if (!dipole_media(client, &known, &known_count, &error)) {
      return cli_fail_error(&error);
    }
    const int status = take_named(settings, known, known_count, profile);
    free(known);
    return status;
  }
  cli_profile_set_channels(profile, count, layers > 0 ? (uint32_t)layers : 1);
  for (size_t i = 0; i < count; i++) {
    snprintf(profile->names[i], CLI_CHANNEL_BYTES, "%zu", i + 1);
    set_medium(settings, i, NULL, &profile->media[i]);
  }
  for (size_t i = 0; i < layers; i++) {
    cli_layer_read(settings->layer.items[i], &profile->media[i]);
  }
  return CLI_OK;
}

/* Counts the channels. All options that have more than one value must have the same number. */
static bool count_channels(const cli_settings *settings, size_t *count) {
  size_t colours[CLI_COLOURS];
  const struct {
    const char *name;
    size_t count;
  } options[] = {{"medium", settings->medium.count * list_colours(settings, colours)},
                 {"sigma-a", settings->sigma_a.count},
                 {"sigma-s", settings->sigma_s.count},
                 {"g", settings->g.count},
                 {"eta", settings->eta.count},
                 {"thickness", settings->thickness.count}};
  const char *first = settings->medium.count > 0 ? "medium" : NULL;
  *count = settings->medium.count > 0 ? options[0].count : 1;
  for (size_t i = 1; i < sizeof options / sizeof options[0]; i++) {
    if (options[i].count > 1 && first != NULL && options[i].count != *count) {
      return cli_fails_usage("--%s has %zu values and --%s has %zu: give one value or as many",
                             options[i].name, options[i].count, first, *count);
    }
    if (options[i].count > 1 && first == NULL) {
      first = options[i].name;
      *count = options[i].count;
    }
  }
  return true;
}

/* ---- the whole profile ----------------------------------------------------------------------- */

bool cli_profile_take_names(const cli_settings *settings, dipole_client *client,
                            cli_profile *profile) {
  const struct {
    const dipole_choice **to;
    enum dipole_kind kind;
    const char *option, *name;
  } choices[] = {
      {&profile->model, DIPOLE_MODEL, "model",
       settings->model.whole == NULL && settings->model.count > 0 ? settings->model.items[0]
                                                                  : NULL},
      {&profile->moments, DIPOLE_MOMENTS, "moments",
       settings->moments != NULL ? settings->moments : "exact"},
      {&profile->evaluator, DIPOLE_EVALUATOR, "evaluator", settings->evaluator},
  };
  profile->info = dipole_get_info(client);
  for (size_t i = 0; i < sizeof choices / sizeof choices[0]; i++) {
    if (choices[i].name != NULL) {
      *choices[i].to =
          cli_named(profile->info, choices[i].kind, choices[i].option, choices[i].name);
      if (*choices[i].to == NULL) {
        return false;
      }
    }
  }
  return take_parameters(profile->info, settings, &profile->parameters);
}

void cli_profile_set_channels(cli_profile *profile, size_t count, uint32_t layer_count) {
  profile->channel_count = count;
  profile->layer_count = layer_count;
  profile->names = cli_allocate(count, sizeof *profile->names);
  profile->media = cli_allocate(count * layer_count, sizeof *profile->media);
}

int cli_profile_take(const cli_settings *settings, dipole_client *client, cli_profile *profile) {
  size_t count;
  if (!cli_profile_take_names(settings, client, profile)) {
    return CLI_USAGE;
  }
  if (settings->tissue.count > 0) {
    return cli_tissue_take(settings, client, profile);
  }
  if (!count_channels(settings, &count)) {
    return CLI_USAGE;
  }
  return take_media(settings, client, count, profile);
}

bool cli_quantities_take(const dipole_info *info, const cli_texts *names, unsigned usual,
                         unsigned single, cli_quantities *quantities) {
  const dipole_choice *quantity;
  *quantities = (cli_quantities){.wanted = names->count == 0 ? usual : 0};
  for (size_t i = 0; i < names->count; i++) {
    quantity = cli_named(info, DIPOLE_QUANTITY, "wanted", names->items[i]);
    if (quantity == NULL) {
      return false;
    }
    if (quantity->id == DIPOLE_MODEL_ERROR) {
      return cli_fails_usage(
          "--wanted model_error: it is written beside the values; `dipole points` has "
          "--errors for it");
    }
    quantities->wanted |= quantity->id;
  }
  for (size_t from = 0; quantities->count < CLI_QUANTITIES_MAX &&
                        (quantity = cli_next_choice(info, DIPOLE_QUANTITY, &from)) != NULL;) {
    /* sums of several quantities have no values of their own */
    if (__builtin_popcount(quantity->id) == 1 &&
        (quantities->wanted & quantity->id & ~single) != 0) {
      quantities->items[quantities->count++] = quantity;
    }
  }
  return true;
}

/* ---- what reports say of a profile ----------------------------------------------------------- */

void cli_put_parameters(cli_rows *rows, const dipole_info *info, const cli_parameters *parameters) {
  for (size_t i = 0; i < parameters->count; i++) {
    const dipole_parameter *one = &parameters->items[i];
    const dipole_choice *choice = cli_choice_of_id(info, DIPOLE_PARAMETER, one->id);
    const dipole_choice *named =
        is_named(choice) ? cli_choice_of_id(info, kind_of(choice), (unsigned)one->value) : NULL;
    if (named != NULL) {
      cli_put_text(rows, named->name, choice->name);
    } else {
      cli_put_number(rows, one->value, choice->name);
    }
  }
}

void cli_put_tissue(cli_rows *rows, const cli_profile *profile) {
  if (profile->tissue != NULL) {
    cli_put_text(rows, profile->tissue, "tissue", "");
    cli_put_text(rows, profile->haemoglobin->name, "haemoglobin", "haemoglobin by");
  }
}

void cli_put_profile(cli_rows *rows, const cli_profile *profile) {
  const struct {
    const char *name;
    const dipole_choice *choice;
  } choices[] = {
      {"model", profile->model}, {"evaluator", profile->evaluator}, {"moments", profile->moments}};
  cli_put_text(rows, profile->info->software, "software", .forms = CLI_IN_JSON);
  if (profile->medium != NULL) {
    cli_put_text(rows, profile->medium, "medium", "");
  }
  cli_put_tissue(rows, profile);
  for (size_t i = 0; i < sizeof choices / sizeof choices[0]; i++) {
    if (choices[i].choice != NULL) {
      cli_put_text(rows, choices[i].choice->name, choices[i].name);
    }
  }
  cli_put_parameters(rows, profile->info, &profile->parameters);
}

void cli_put_notes(cli_rows *rows, const dipole_info *info, unsigned notes) {
  const dipole_choice *note;
  char text[256] = "";
  size_t length = 0;
  for (size_t from = 0;
       length < sizeof text && (note = cli_next_note(info, notes, &from)) != NULL;) {
    length += (size_t)snprintf(text + length, sizeof text - length, "%s%s", length > 0 ? " " : "",
                               note->name);
  }
  cli_put_text(rows, text, "notes");
}

void cli_write_launched(const dipole_medium *media, size_t count, uint32_t layer_count) {
  const char *before = "per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 =";
  for (size_t i = 0; i < count; i++) {
    bool reported = false;
    for (size_t k = 0; k < i; k++) {
      reported = reported || media[k * layer_count].eta == media[i * layer_count].eta;
    }
    if (!reported) {
      const double eta = media[i * layer_count].eta, share = (eta - 1) / (eta + 1);
      printf("%s %.6g (eta %.6g)", before, 1 - share * share, eta);
      before = ",";
    }
  }
  putchar('\n');
}

void cli_write_notes(const dipole_info *info, unsigned notes) {
  const dipole_choice *note;
  for (size_t from = 0; (note = cli_next_note(info, notes, &from)) != NULL;) {
    printf("note: %s: %s\n", note->name, note->about);
  }
}
