#include "clients/cli/profile.h"

#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/number.h"
#include "clients/cli/options.h"
#include "core/core.h"

#define G_DEFAULT 0.0
#define ETA_DEFAULT 1.3

#define FIELD(name) offsetof(cli_profile_settings, name)

const cli_option cli_medium_options[] = {
    {"Medium", NULL, NULL, CLI_HEADING, 0, NULL},
    {"medium", "NAME[,NAME...]",
     "measured media: red, green and blue of each; `dipole media` lists them", CLI_TEXT,
     FIELD(medium), NULL},
    {"channel", "COLOUR[,...]", "red, green or blue. Only these channels are taken (default: all)",
     CLI_NAMES, FIELD(channel), NULL},
    {"sigma-a", "X[,X...]", "absorption coefficient, 1/mm; one value for each channel", CLI_NUMBERS,
     FIELD(sigma_a), NULL},
    {"sigma-s", "X[,X...]", "scattering coefficient, 1/mm; a single value is for all channels",
     CLI_NUMBERS, FIELD(sigma_s), NULL},
    {"g", "X[,X...]",
     "mean cosine of the scattering angle (default: 0); sigma_s (1 - g) of a\n"
     "measured medium stays as it was measured",
     CLI_NUMBERS, FIELD(g), NULL},
    {"eta", "X[,X...]",
     "refractive index inside over outside (default: that of the measured\nmedium, else 1.3)",
     CLI_NUMBERS, FIELD(eta), NULL},
    {0},
};

const cli_option cli_parameter_options[] = {
    {"Parameters, for the models that take them", NULL, NULL, CLI_HEADING, 0, NULL},
    {"tolerance", "X",
     "largest relative numerical error, for models that can choose it, and\n"
     "for tables. Without --model, in eval, plot and points: largest error of\n"
     "the answer against radiative transport",
     CLI_NUMBER, FIELD(tolerance), NULL},
    {"cos-in", "X", "cosine of the angle of incidence, for S (default: 1)", CLI_NUMBER,
     FIELD(cos_in), NULL},
    {"cos-out", "X", "cosine of the angle of exit, for S (default: 1)", CLI_NUMBER, FIELD(cos_out),
     NULL},
    {"thickness", "X", "of a slab, mm; the models of slabs need it", CLI_NUMBER, FIELD(thickness),
     NULL},
    {"surface-albedo", "X", "A of Burley's models (default: the albedo by the better dipole)",
     CLI_NUMBER, FIELD(surface_albedo), NULL},
    {"gaussians", "N", "how many Gaussians are fitted (default: 6)", CLI_NUMBER, FIELD(gaussians),
     NULL},
    {"fit-model", "NAME", "name or id of the model that Gaussians are fitted to (default: better)",
     CLI_TEXT, FIELD(fit_model), NULL},
    {"fit-from", "X", "smallest radius of the fit, mm (default: 0.1 mean free paths)", CLI_NUMBER,
     FIELD(fit_from), NULL},
    {"fit-to", "X", "largest radius of the fit, mm (default: 10 mean free paths)", CLI_NUMBER,
     FIELD(fit_to), NULL},
    {"gamma", "X", "of the phase function, (1 - g_2) / (1 - g), for transport (default: 1 + g)",
     CLI_NUMBER, FIELD(gamma), NULL},
    {0},
};

const char *cli_usual_evaluator(const cli_profile_settings *settings, const char *model) {
  const bool tabled =
      !settings->tolerance.given || settings->tolerance.value >= CORE_LUT_TOLERANCE_MIN;
  return tabled && (model == NULL || strcmp(model, CLI_MODEL_DEFAULT) == 0) ? "lut" : "f64";
}

/* ---- lengths --------------------------------------------------------------------------------- */

const cli_numbers *cli_lengths_find(const cli_lengths *lengths, const char **name) {
  const struct {
    const char *name;
    const cli_numbers *numbers;
  } all[] = {{"mean-free-path", &lengths->free_path},
             {"diffuse-mean-free-path", &lengths->diffuse_path},
             {"classical-diffuse-path", &lengths->classical_path}};
  const cli_numbers *found = NULL;
  size_t given = 0;
  for (size_t i = 0; i < sizeof all / sizeof all[0]; i++) {
    if (all[i].numbers->count > 0) {
      found = all[i].numbers;
      *name = all[i].name;
      given++;
    }
  }
  if (given != 1) {
    cli_fail_usage("give exactly one of --mean-free-path, --diffuse-mean-free-path and "
                   "--classical-diffuse-path, in mm");
    return NULL;
  }
  return found;
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

/* Returns the daemon's parameter that an option stands for; NULL if it has none. */
static const dipole_choice *parameter_of(const dipole_info *info, const char *option) {
  char name[64];
  snprintf(name, sizeof name, "%s", option);
  for (char *dash; (dash = strchr(name, '-')) != NULL;) {
    *dash = '_';
  }
  return cli_choice(info, DIPOLE_PARAMETER, name);
}

static bool parse_model(const dipole_info *info, const char *text, double *value) {
  const dipole_choice *model = cli_choice(info, DIPOLE_MODEL, text);
  if (model != NULL) {
    *value = model->id;
  }
  return model != NULL || cli_number_parse(text, value);
}

bool cli_parameter_parse(const dipole_info *info, const dipole_choice *parameter, const char *text,
                         double *value) {
  for (const cli_option *option = cli_parameter_options; option->name != NULL; option++) {
    if (option->kind == CLI_TEXT && parameter_of(info, option->name) == parameter) {
      return parse_model(info, text, value);
    }
  }
  return cli_number_parse(text, value);
}

/* Returns whether a parameter's option is given. Sets *number, or *text for the name of a model. */
static bool is_given(const cli_option *option, const cli_profile_settings *settings,
                     const char **text, double *number) {
  const void *at = (const char *)settings + option->offset;
  *text = option->kind == CLI_TEXT ? *(const char *const *)at : NULL;
  *number = option->kind == CLI_NUMBER ? ((const cli_number *)at)->value : 0;
  return *text != NULL || (option->kind == CLI_NUMBER && ((const cli_number *)at)->given);
}

bool cli_parameters_given(const cli_profile_settings *settings) {
  const char *text;
  double number;
  const cli_option *option = cli_parameter_options;
  while (option->name != NULL && !is_given(option, settings, &text, &number)) {
    option++;
  }
  return option->name != NULL;
}

static bool fail_unknown(const dipole_info *info, const cli_option *option, const char *what,
                         enum dipole_kind kind) {
  char known[1024];
  cli_list_names(info, kind, known, sizeof known);
  cli_fail_usage("--%s: %s %s", option->name, what, known);
  return false;
}

bool cli_parameters_take(const dipole_info *info, const cli_profile_settings *settings,
                         cli_parameters *parameters) {
  const char *text;
  double value;
  *parameters = (cli_parameters){0};
  for (const cli_option *option = cli_parameter_options; option->name != NULL; option++) {
    if (!is_given(option, settings, &text, &value)) {
      continue;
    }
    const dipole_choice *parameter = parameter_of(info, option->name);
    if (parameter == NULL) {
      return fail_unknown(info, option, "this daemon does not know it; it knows", DIPOLE_PARAMETER);
    }
    if (text != NULL && !parse_model(info, text, &value)) {
      return fail_unknown(info, option, "there is no such model; this daemon has", DIPOLE_MODEL);
    }
    cli_parameters_set(parameters, parameter->id, value);
  }
  return true;
}

/* ---- the medium's options -------------------------------------------------------------------- */

const char *const cli_colours[CLI_COLOURS] = {"red", "green", "blue"};

bool cli_medium_given(const cli_profile_settings *settings) {
  return settings->medium != NULL || settings->channel.count > 0 || settings->sigma_a.count > 0 ||
         settings->sigma_s.count > 0 || settings->g.count > 0 || settings->eta.count > 0;
}

/* Returns whether a colour of a measured medium is asked for; all are if none is named. */
static bool is_asked(const cli_profile_settings *settings, size_t colour) {
  return settings->channel.count == 0 || cli_texts_have(&settings->channel, cli_colours[colour]);
}

size_t cli_colour(const char *name) {
  size_t i = 0;
  while (i < CLI_COLOURS && (name == NULL || strcmp(cli_colours[i], name) != 0)) {
    i++;
  }
  return i;
}

int cli_medium_check(const cli_profile_settings *settings) {
  if (settings->medium == NULL && (settings->sigma_a.count == 0 || settings->sigma_s.count == 0)) {
    return cli_fail_usage("give --medium NAME, or --sigma-a and --sigma-s");
  }
  if (settings->medium != NULL && (settings->sigma_a.count > 0 || settings->sigma_s.count > 0)) {
    return cli_fail_usage("--medium NAME stands for --sigma-a and --sigma-s: leave these out; --g "
                          "and --eta may stay");
  }
  if (settings->medium == NULL && settings->channel.count > 0) {
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

int cli_deadline_check(const cli_profile_settings *settings) {
  return settings->deadline_ms.value <= UINT32_MAX
             ? CLI_OK
             : cli_fail_usage("--deadline-ms: give at most %lu", (unsigned long)UINT32_MAX);
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

int cli_find_medium(dipole_client *client, const char *name, dipole_measured_medium *medium) {
  dipole_measured_medium *media;
  dipole_error error;
  size_t count, at = 0;
  if (!dipole_media(client, &media, &count, &error)) {
    return cli_fail_error(&error);
  }
  while (at < count && strcmp(media[at].name, name) != 0) {
    at++;
  }
  const int status = at < count ? CLI_OK : fail_unknown_medium(name, media, count);
  if (status == CLI_OK) {
    *medium = media[at];
  }
  free(media);
  return status;
}

/* Adds the channels of a measured medium that are asked for, from position *at on. If there are
 * several media, the names of the channels begin with that of the medium. */
static void add_measured(const cli_profile_settings *settings, const dipole_measured_medium *medium,
                         bool several, cli_profile *profile, size_t *at) {
  for (size_t i = 0; i < CLI_COLOURS; i++) {
    if (is_asked(settings, i)) {
      cli_channel *channel = &profile->channels[*at];
      snprintf(channel->name, sizeof channel->name, "%s%s%s", several ? medium->name : "",
               several ? " " : "", cli_colours[i]);
      channel->medium = medium->channel[i];
      const double g = cli_numbers_pick(&settings->g, *at, channel->medium.g);
      channel->medium.sigma_s_per_mm *= (1 - channel->medium.g) / (1 - g);
      channel->medium.g = g;
      channel->medium.eta = cli_numbers_pick(&settings->eta, *at, channel->medium.eta);
      ++*at;
    }
  }
}

static int take_measured(const cli_profile_settings *settings, dipole_client *client,
                         cli_profile *profile) {
  const bool several = strchr(settings->medium, ',') != NULL;
  size_t at = 0;
  int status = CLI_OK;
  profile->medium = settings->medium;
  for (const char *names = settings->medium; status == CLI_OK && names != NULL;) {
    dipole_measured_medium medium;
    char name[64];
    const size_t length = strcspn(names, ",");
    snprintf(name, sizeof name, "%.*s", (int)length, names);
    names = names[length] == ',' ? names + length + 1 : NULL;
    status = cli_find_medium(client, name, &medium);
    if (status == CLI_OK) {
      add_measured(settings, &medium, several, profile, &at);
    }
  }
  return status;
}

static void take_given(const cli_profile_settings *settings, cli_profile *profile) {
  for (size_t i = 0; i < profile->channel_count; i++) {
    cli_channel *channel = &profile->channels[i];
    snprintf(channel->name, sizeof channel->name, "%zu", i + 1);
    channel->medium = (dipole_medium){.sigma_a_per_mm = cli_numbers_pick(&settings->sigma_a, i, 0),
                                      .sigma_s_per_mm = cli_numbers_pick(&settings->sigma_s, i, 0),
                                      .g = cli_numbers_pick(&settings->g, i, G_DEFAULT),
                                      .eta = cli_numbers_pick(&settings->eta, i, ETA_DEFAULT)};
  }
}

static size_t count_measured(const cli_profile_settings *settings) {
  size_t media = 1, asked = 0;
  for (const char *comma = settings->medium; (comma = strchr(comma, ',')) != NULL; comma++) {
    media++;
  }
  for (size_t i = 0; i < CLI_COLOURS; i++) {
    asked += is_asked(settings, i);
  }
  return media * asked;
}

/* Counts the channels. All options that have more than one value must have the same number. */
static bool count_channels(const cli_profile_settings *settings, size_t *count) {
  const struct {
    const char *name;
    size_t count;
  } options[] = {{"medium", settings->medium != NULL ? count_measured(settings) : 0},
                 {"sigma-a", settings->sigma_a.count},
                 {"sigma-s", settings->sigma_s.count},
                 {"g", settings->g.count},
                 {"eta", settings->eta.count}};
  const char *first = settings->medium != NULL ? "medium" : NULL;
  *count = settings->medium != NULL ? options[0].count : 1;
  for (size_t i = 1; i < sizeof options / sizeof options[0]; i++) {
    if (options[i].count > 1 && first != NULL && options[i].count != *count) {
      cli_fail_usage("--%s has %zu values and --%s has %zu: give one value or as many",
                     options[i].name, options[i].count, first, *count);
      return false;
    }
    if (options[i].count > 1 && first == NULL) {
      first = options[i].name;
      *count = options[i].count;
    }
  }
  return true;
}

/* ---- the whole profile ----------------------------------------------------------------------- */

static bool take_names(const cli_profile_settings *settings, cli_profile *profile) {
  const struct {
    const dipole_choice **to;
    enum dipole_kind kind;
    const char *option, *name;
  } choices[] = {
      {&profile->model, DIPOLE_MODEL, "model", settings->model},
      {&profile->moments, DIPOLE_MOMENTS, "moments", settings->moments},
      {&profile->evaluator, DIPOLE_EVALUATOR, "evaluator", settings->evaluator},
  };
  for (size_t i = 0; i < sizeof choices / sizeof choices[0]; i++) {
    if (choices[i].name != NULL) {
      *choices[i].to =
          cli_named(profile->info, choices[i].kind, choices[i].option, choices[i].name);
      if (*choices[i].to == NULL) {
        return false;
      }
    }
  }
  return true;
}

void cli_profile_set_channels(cli_profile *profile, size_t count) {
  profile->channel_count = count;
  profile->channels = cli_allocate(count, sizeof *profile->channels);
  profile->media = cli_allocate(count, sizeof *profile->media);
}

int cli_profile_take(const cli_profile_settings *settings, dipole_client *client,
                     cli_profile *profile) {
  size_t count;
  profile->info = dipole_get_info(client);
  if (!take_names(settings, profile) ||
      !cli_parameters_take(profile->info, settings, &profile->parameters) ||
      !count_channels(settings, &count)) {
    return CLI_USAGE;
  }
  cli_profile_set_channels(profile, count);
  int status = CLI_OK;
  if (settings->medium != NULL) {
    status = take_measured(settings, client, profile);
  } else {
    take_given(settings, profile);
  }
  for (size_t i = 0; i < count; i++) {
    profile->media[i] = profile->channels[i].medium;
  }
  return status;
}

void cli_profile_free(cli_profile *profile) {
  free(profile->channels);
  free(profile->media);
}

/* Returns whether an id is that of one quantity. Sums of several quantities have no values of their
 * own. */
static bool is_one_bit(unsigned id) {
  return id != 0 && (id & (id - 1)) == 0;
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
      return cli_fail_usage(
          "--wanted model_error: it is written beside the values; `dipole points` "
          "has --errors for it");
    }
    quantities->wanted |= quantity->id;
  }
  for (size_t from = 0; quantities->count < CLI_QUANTITIES_MAX &&
                        (quantity = cli_next_choice(info, DIPOLE_QUANTITY, &from)) != NULL;) {
    if (is_one_bit(quantity->id) && (quantities->wanted & quantity->id & ~single) != 0) {
      quantities->items[quantities->count++] = quantity;
    }
  }
  return true;
}

/* ---- what reports say of a profile ----------------------------------------------------------- */

void cli_write_medium(const cli_profile *profile, FILE *file) {
  if (profile->medium != NULL) {
    fprintf(file, "%s: ", profile->medium);
  }
}

static const char *parameter_name(const cli_profile *profile, size_t index) {
  const dipole_choice *choice =
      cli_choice_of_id(profile->info, DIPOLE_PARAMETER, profile->parameters.items[index].id);
  return choice != NULL ? choice->name : "";
}

void cli_write_parameters(const cli_profile *profile, FILE *file) {
  char text[CLI_NUMBER_BYTES];
  for (size_t i = 0; i < profile->parameters.count; i++) {
    fprintf(file, ", %s %s", parameter_name(profile, i),
            cli_number_format(profile->parameters.items[i].value, text));
  }
}

void cli_write_launched(const dipole_medium *media, size_t count, FILE *file) {
  const char *before = "per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 =";
  for (size_t i = 0; i < count; i++) {
    bool told = false;
    for (size_t k = 0; k < i; k++) {
      told = told || media[k].eta == media[i].eta;
    }
    if (!told) {
      const double share = (media[i].eta - 1) / (media[i].eta + 1);
      fprintf(file, "%s %.6g (eta %.6g)", before, 1 - share * share, media[i].eta);
      before = ",";
    }
  }
  fputs(count > 0 ? "\n" : "", file);
}

void cli_write_notes(const dipole_info *info, unsigned notes, FILE *file) {
  const dipole_choice *note;
  for (size_t from = 0; (note = cli_next_note(info, notes, &from)) != NULL;) {
    fprintf(file, "note: %s: %s\n", note->name, note->about);
  }
}

void cli_json_head(cli_json *json, const cli_profile *profile) {
  cli_json_text(json, "software", profile->info->software);
  cli_json_text(json, "instruction_set", profile->info->instruction_set);
  if (profile->medium != NULL) {
    cli_json_text(json, "medium", profile->medium);
  }
}

void cli_json_parameters(cli_json *json, const cli_profile *profile) {
  cli_json_begin(json, "parameters", '{');
  for (size_t i = 0; i < profile->parameters.count; i++) {
    cli_json_number(json, parameter_name(profile, i), profile->parameters.items[i].value);
  }
  cli_json_end(json, '}');
}

void cli_json_notes(cli_json *json, const dipole_info *info, unsigned notes) {
  const dipole_choice *note;
  cli_json_begin(json, "notes", '[');
  for (size_t from = 0; (note = cli_next_note(info, notes, &from)) != NULL;) {
    cli_json_text(json, NULL, note->name);
  }
  cli_json_end(json, ']');
}
