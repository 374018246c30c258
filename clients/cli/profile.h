/* profile: the medium, the model and its parameters, as options that most commands share. */
#ifndef DIPOLE_CLI_PROFILE_H
#define DIPOLE_CLI_PROFILE_H

#include "clients/cli/cli.h"
#include "clients/cli/rows.h"
#include "core/tissue/tissue.h"

/* ---- options --------------------------------------------------------------------------------- */

/* For cli_command.parameters: those of the models, with their tolerances, and a bit of any. */
#define CLI_PARAMETER_BIT(IDENT) (1U << CORE_PARAMETER_##IDENT)
#define CLI_OF_MODELS                                                                              \
  (~(CLI_PARAMETER_BIT(PHASE) | CLI_PARAMETER_BIT(PHASE_SHARE) | CLI_PARAMETER_BIT(PHASE_G) |      \
     CLI_PARAMETER_BIT(DETECTOR_NA)))

/* Those of the models whose media are sought: neither R nor the albedo has directions, and Gaussians
 * are fitted to a medium that is known. */
#define CLI_OF_INVERTED                                                                            \
  (CLI_OF_MODELS &                                                                                 \
   ~(CLI_PARAMETER_BIT(COS_IN) | CLI_PARAMETER_BIT(COS_OUT) | CLI_PARAMETER_BIT(GAUSSIANS) |       \
     CLI_PARAMETER_BIT(FIT_MODEL) | CLI_PARAMETER_BIT(FIT_FROM) | CLI_PARAMETER_BIT(FIT_TO) |      \
     CLI_PARAMETER_BIT(ETA_BELOW) | CLI_PARAMETER_BIT(DERIVATIVE_LAYER)))

/* The options that describe the medium: the members of cli_profile from medium to thickness. */
extern const cli_option cli_medium_options[];

/* For commands that take stacks, behind them: --layer. */
extern const cli_option cli_layer_options[];

#define CLI_MOMENTS_OPTION                                                                         \
  CLI_OPTION(TEXT, moments, NULL, "Fresnel moments; `dipole info` lists them (default: exact)")
#define CLI_DEADLINE_OPTION                                                                        \
  CLI_OPTION(COUNT32, deadline_ms, NULL, "the daemon replies within N ms or refuses; 0: no limit")
#define CLI_EVALUATOR_OPTION                                                                       \
  CLI_OPTION(TEXT, evaluator, NULL,                                                                \
             "f64 or f32: double or single precision; lut: single, by a table (default: f64; lut " \
             "for transport)")

/* The default model and the reason for it, in --help. */
#define CLI_MODEL_DEFAULT "transport"
#define CLI_DEFAULT_TEXT                                                                           \
  "\nIf no model is named, it is transport by table: all other models approximate it, and by "     \
  "table "                                                                                         \
  "they cost the same. The table is within 1e-4 and takes milliseconds to prepare; --evaluator "   \
  "f64 "                                                                                           \
  "takes .2 ms, and 30 times as long for each radius. --model better, which many renderers use, "  \
  "takes microseconds."

#define CLI_UNIT_OPTION                                                                            \
  CLI_OPTION(TEXT, unit, NULL,                                                                     \
             "unit of lengths: mm (default), cm, m, or the millimetres of a scene's unit")

/* The lengths by which a medium can be given with an albedo. */
#define CLI_LENGTH_OPTIONS                                                                         \
  CLI_OPTION(NUMBERS, mean_free_path, NULL, "1 / sigma_t'; a single value is for all channels"),   \
      CLI_OPTION(NUMBERS, diffuse_mean_free_path, NULL,                                            \
                 "instead: 1 / (sigma_t' sqrt(3 a / (1 + a))), a = sigma_a / sigma_t'"),           \
      CLI_OPTION(NUMBERS, classical_diffuse_path, NULL, "instead: 1 / sqrt(3 sigma_a sigma_t')"),  \
      CLI_OPTION(NUMBERS, extinction_path, NULL,                                                   \
                 "instead: 1 / (sigma_a + sigma_s), which most renderers mean"),                   \
      CLI_UNIT_OPTION

/* Options for the meaning of colours. */
#define CLI_COLOUR_OPTIONS                                                                         \
  CLI_OPTION(TEXT, light, "beam",                                                                  \
             "the light of the colours: beam, at normal incidence, or diffuse, the same from all " \
             "directions"),                                                                        \
      CLI_OPTION(SWITCH, specular, NULL,                                                           \
                 "the colours contain what the surface itself reflects (Fresnel)")

#define CLI_TISSUE_OPTIONS                                                                         \
  {"tissue",                                                                                       \
   "in place of all this: a tissue by name, properties, or both, as liver,hbo2=100; `dipole "      \
   "tissue` lists them. Several are layers, from the top down, with thickness=MM",                 \
   CLI_FILES,                                                                                      \
   offsetof(cli_settings, tissue),                                                                 \
   NULL,                                                                                           \
   "[NAME][,PROPERTY=X]..."},                                                                      \
      {"wavelengths", "for --tissue: the channels, nm",                                            \
       CLI_NAMES,     offsetof(cli_settings, wavelengths),                                         \
       NULL,          "NM[,NM...] or FROM:TO:STEP"},                                               \
      {"scatter",   "for --tissue: the same as a=A,b=B,rayleigh=SHARE in each",                    \
       CLI_NUMBERS, offsetof(cli_settings, scatter),                                               \
       NULL,        "A,B[,SHARE]"},                                                                \
      CLI_OPTION(TEXT, haemoglobin, "prahl",                                                       \
                 "for --tissue: the table of its absorption, prahl or ucl")

/* Returns the linear value of an sRGB value from 0 to 1 (IEC 61966-2-1). */
double cli_srgb_to_linear(double value);

/* Returns the one length that is given, and its name, which is that of the option and of the
 * daemon's choice. If none or several are given, says so and returns NULL. */
const cli_numbers *cli_lengths_find(const cli_settings *settings, const char **name);

/* Returns the millimetres of --unit. Reports an error and returns NAN if it is no unit. */
double cli_unit_mm(const cli_settings *settings);

/* Returns the evaluator that is taken if none is given: the table for transport, where it can be as
 * exact as the tolerance. model: NULL if none is named. */
const char *cli_usual_evaluator(const cli_settings *settings, const char *model);

/* Checks the options of the medium without a daemon, and returns an exit status. */
int cli_medium_check(const cli_settings *settings);

/* The same for the options of a tissue (clients/cli/tissue.c). */
int cli_tissue_check(const cli_settings *settings);

/* Returns whether any option of the medium but --tissue is given. */
bool cli_medium_given(const cli_settings *settings);

/* ---- parameters ------------------------------------------------------------------------------ */

enum { CLI_PARAMETERS_MAX = 32 };

/* The parameters that are given, each of them once. */
typedef struct cli_parameters {
  size_t count;
  dipole_parameter items[CLI_PARAMETERS_MAX];
} cli_parameters;

/* Sets a parameter, or changes it if it is set already. */
void cli_parameters_set(cli_parameters *parameters, unsigned id, double value);

/* Removes a parameter. Returns false if it is not set. */
bool cli_parameters_remove(cli_parameters *parameters, unsigned id);

/* Reads the value of a parameter of the daemon: a number, or a name or id of a list. */
bool cli_parameter_parse(const dipole_info *info, const dipole_choice *parameter, const char *text,
                         double *value);

/* ---- media ----------------------------------------------------------------------------------- */

enum { CLI_COLOURS = 3 };

/* The channels of a measured medium: red, green, blue. */
extern const char *const cli_colours[CLI_COLOURS];

/* Returns the index of the colour with this name; CLI_COLOURS if there is none or name is NULL. */
size_t cli_colour(const char *name);

enum { CLI_CHANNEL_BYTES = 36 };

/* Reads a layer: SIGMA_A,SIGMA_S,G,ETA and, unless it is a half space, its thickness in mm. Returns
 * false if the text is no such list of numbers. */
bool cli_layer_read(const char *text, dipole_medium *layer);

/* ---- the whole profile ----------------------------------------------------------------------- */

typedef struct cli_profile {
  const dipole_info *info;
  const dipole_choice *model, *moments, *evaluator; /* NULL: the settings do not name it */
  cli_parameters parameters;
  const char *medium; /* names of measured media, as given; NULL if there are none */
  const char *tissue; /* as given, and what it has; NULL: the media are no tissue */
  const dipole_choice *haemoglobin;
  const double *wavelengths_nm; /* [channel_count] */
  size_t channel_count;
  char (*names)[CLI_CHANNEL_BYTES]; /* [channel_count] names of the channels */
  uint32_t layer_count;             /* of each medium */
  dipole_medium *media;             /* [channel_count][layer_count] */
} cli_profile;

/* Returns the layers of a channel's medium. */
static inline const dipole_medium *cli_profile_layers(const cli_profile *profile, size_t channel) {
  return &profile->media[channel * profile->layer_count];
}

/* What all queries have of a profile; and its media, for those that have all of them. */
#define CLI_QUERY_OF(profile)                                                                      \
  .moments = (profile)->moments->id, .parameters = (profile)->parameters.items,                    \
  .parameter_count = (profile)->parameters.count
#define CLI_MEDIA_OF(profile)                                                                      \
  .media = (profile)->media, .layer_count = (profile)->layer_count,                                \
  .medium_count = (uint32_t)(profile)->channel_count
#define CLI_DEADLINE_OF(settings) .deadline_ms = (uint32_t)(settings)->deadline_ms.value

/* Looks up the names in the settings, except those of a list of models, and reads the parameters.
 * Says what is wrong and returns false if the daemon does not know one of them. */
bool cli_profile_take_names(const cli_settings *settings, dipole_client *client,
                            cli_profile *profile);

/* Looks up the names and reads the parameters and the media. Returns an exit status. */
int cli_profile_take(const cli_settings *settings, dipole_client *client, cli_profile *profile);

/* Sets the media of a tissue, of a profile whose info is there: a channel for each wavelength. Says what
 * is wrong and returns an exit status. */
int cli_tissue_take(const cli_settings *settings, dipole_client *client, cli_profile *profile);

/* Finds a property by its name, with or without the last words of it, as hbo2 for hbo2_uM. Says what is
 * wrong with the option and returns NULL if there is none, or several. */
const dipole_choice *cli_property(const dipole_info *info, const char *option, const char *name);

/* Reads a text of --tissue: a name, and properties. Says what is wrong and returns false. */
bool cli_tissue_read(const dipole_info *info, const char *text, dipole_tissue_query *query,
                     dipole_parameter properties[CORE_PROPERTIES_END]);

/* Sets the numbers of channels and of layers and allocates the channels' arrays. */
void cli_profile_set_channels(cli_profile *profile, size_t count, uint32_t layer_count);

/* The quantities that --wanted requests. */
enum { CLI_QUANTITIES_MAX = 32 };

typedef struct cli_quantities {
  unsigned wanted; /* mask of all quantities */
  size_t count;    /* number of quantities with a value for each radius */
  /* the quantities, in the order of the daemon's list */
  const dipole_choice *items[CLI_QUANTITIES_MAX];
} cli_quantities;

/* Looks up the names. Without names, the quantities in the sum `usual` are wanted. Quantities in
 * the sum `single` can be wanted, but are no items. Says so and returns false if one is unknown. */
bool cli_quantities_take(const dipole_info *info, const cli_texts *names, unsigned usual,
                         unsigned single, cli_quantities *quantities);

/* ---- what reports say of a profile ----------------------------------------------------------- */

/* Writes what all reports begin with: the software in JSON, the medium if it is measured, the model,
 * evaluator and moments that are set, and the parameters. */
void cli_put_profile(cli_rows *rows, const cli_profile *profile);

/* Writes the tissue and its table of haemoglobin, if the media are one. */
void cli_put_tissue(cli_rows *rows, const cli_profile *profile);

/* Writes parameters, which the daemon lists. */
void cli_put_parameters(cli_rows *rows, const dipole_info *info, const cli_parameters *parameters);

/* Writes the names of the notes in the sum `notes`, with blanks between them. */
void cli_put_notes(cli_rows *rows, const dipole_info *info, unsigned notes);

/* How to get from power that entered to power that was launched, for each eta of the media: rule E8
 * of proto/PROTOCOL.md. media: [count][layer_count] */
void cli_write_launched(const dipole_medium *media, size_t count, uint32_t layer_count);

/* "note: NAME: what it says", a line for each note in the sum `notes`. */
void cli_write_notes(const dipole_info *info, unsigned notes);

#endif
