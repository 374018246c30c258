/* dipole convert: converts a colour and a length, as one renderer defines them, to coefficients or
 * to the parameters of another renderer. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/edge.h"
#include "clients/cli/material.h"
#include "clients/cli/options.h"
#include "clients/cli/profile.h"
#include "clients/cli/rows.h"

/* From HULST on, a formula gives the albedo; the last two are of walks without an interface. */
enum colour_kind {
  SMOOTH,
  CLASSICAL,
  HULST,
  HULST_G0,
  WRENNINGE,
  HULST_FREE,
  WRENNINGE_FREE,
};
enum length_kind { EXTINCTION, CLASSICAL_LENGTH, SKIN, BURLEY, BLENDER, UNREAL };

/* How --format native writes a material: a text before it, formats of a parameter with three
 * numbers and of one with a single number, and a text after it. A %s in the two texts is replaced by
 * the element. In files, this is the element of MaterialX, or the extension of glTF. */
typedef struct native_form {
  const char *first, *three, *one, *last, *element;
} native_form;

#define MTLX_HEAD "<?xml version=\"1.0\"?>\n<materialx version=\"1.39\">\n"
#define MTLX_LAST "  </%s>\n</materialx>\n"
#define MTLX_THREE "    <input name=\"%s\" type=\"color3\" value=\"%.9g, %.9g, %.9g\" />\n"
#define MTLX_ONE "    <input name=\"%s\" type=\"float\" value=\"%.9g\" />\n"

static const native_form form_NONE = {0};
static const native_form form_OPENPBR = {
    MTLX_HEAD "  <%s name=\"subsurface\" type=\"surfaceshader\">\n"
              "    <input name=\"subsurface_weight\" type=\"float\" value=\"1\" />\n",
    MTLX_THREE, MTLX_ONE, MTLX_LAST, "open_pbr_surface"};
static const native_form form_STANDARD_SURFACE = {
    MTLX_HEAD "  <%s name=\"surface\" type=\"surfaceshader\">\n"
              "    <input name=\"subsurface\" type=\"float\" value=\"1\" />\n",
    MTLX_THREE, MTLX_ONE, MTLX_LAST, "standard_surface"};
static const native_form form_MATERIALX = {MTLX_HEAD "  <%s name=\"subsurface\" type=\"BSDF\">\n",
                                           MTLX_THREE, MTLX_ONE, MTLX_LAST, "subsurface_bsdf"};
static const native_form form_BLENDER = {
    "# bsdf: the node Principled BSDF\n"
    "bsdf.inputs[\"Subsurface Weight\"].default_value = 1\n",
    "bsdf.inputs[\"%s\"].default_value[:3] = (%.9g, %.9g, %.9g)\n",
    "bsdf.inputs[\"%s\"].default_value = %.9g\n", "", NULL};
static const native_form form_BLENDER_3 = {
    "# bsdf: the node Principled BSDF\n"
    "bsdf.subsurface_method = \"RANDOM_WALK\"\n"
    "bsdf.inputs[\"Subsurface\"].default_value = 1\n",
    "bsdf.inputs[\"%s\"].default_value[:3] = (%.9g, %.9g, %.9g)\n",
    "bsdf.inputs[\"%s\"].default_value = %.9g\n", "", NULL};
static const native_form form_PBRT = {"Material \"subsurface\"", " \"rgb %s\" [ %.9g %.9g %.9g ]",
                                      " \"float %s\" [ %.9g ]", "\n", NULL};
static const native_form form_UNREAL = {
    "# profile: an unreal.SubsurfaceProfileStruct\n",
    "profile.set_editor_property(\"%s\", unreal.LinearColor(%.9g, %.9g, %.9g, 1))\n",
    "profile.set_editor_property(\"%s\", %.9g)\n", "", NULL};
static const native_form form_UNITY = {"", "%s: {r: %.9g, g: %.9g, b: %.9g, a: 1}\n", "%s: %.9g\n",
                                       "", NULL};
/* write_gltf() */
static const native_form form_GLTF = {.element = "KHR_materials_scatter"};
static const native_form form_GLTF_DRAFT = {.element = "KHR_materials_volume_scatter"};

enum { NAME_COLOUR, NAME_LENGTHS, NAME_FACTOR, NAME_G, NAME_ETA, NAMES };

typedef struct convention {
  const char *name;
  enum colour_kind colour;
  enum length_kind length;
  double unit_mm; /* 0: --unit */
  const native_form *form;
  const char *names, *source, *note;
} convention;

#define CONVENTION(name, COLOUR, LENGTH, unit_mm, FORM, names, source, note)                       \
  {name, COLOUR, LENGTH, unit_mm, &form_##FORM, names, source, note},
static const convention conventions[] = {
#include "clients/cli/conventions.def"
};
enum { CONVENTIONS = sizeof conventions / sizeof conventions[0] };

#define COEFFICIENTS "coefficients"

static const cli_option options[] = {
    CLI_TITLE("Conventions"),
    {"from", "what the numbers below mean: a convention, or coefficients", CLI_TEXT,
     offsetof(cli_settings, source), NULL, "NAME"},
    {"to", "what the numbers that are written mean", CLI_TEXT, offsetof(cli_settings, target),
     COEFFICIENTS, "NAME"},
    CLI_OPTION(SWITCH, typed, NULL,
               "write the colour to type into a renderer that makes an albedo of it by van de "
               "Hulst's formula, whatever the convention says"),
    CLI_OPTION(NUMBERS, colour, NULL, "colour, 0 to 1, linear; one value for each channel"),
    CLI_OPTION(SWITCH, srgb, NULL, "the colours are sRGB values"),
    CLI_OPTION(NUMBERS, length, NULL,
               "the convention's length times its scale, in its unit; a single value is for all "
               "channels"),
    CLI_UNIT_OPTION,
    {0},
};

/* A material with one or more channels that is being converted. */
typedef struct material {
  const cli_settings *settings;
  dipole_client *client;
  const convention *from, *to; /* NULL: coefficients */
  double unit_mm;              /* scene unit in mm */
  size_t count;
  dipole_medium *media; /* [count] */
  /* [count] the colours and lengths to write; lengths in the target's unit */
  double *colours, *lengths;
  double *typed;                  /* [count] the colours as given; NAN: none */
  double *shown, *shown_as_given; /* [count] colours that a beam shows under transport */
} material;

/* ---- formulas -------------------------------------------------------------------------------- */

/* van de Hulst's reflectance of an index-matched half space in diffuse light, C = (1 - s) (1 - .139
 * s) / (1 + 1.17 s), s^2 = (1 - a) / (1 - g a), a = sigma_s / (sigma_a + sigma_s) (van de Hulst
 * 1980; Kulla, Conty 2017). */
#define HULST_A 0.139
#define HULST_B 1.17

static double hulst_colour(double absorbed, double g) {
  const double s = sqrt(absorbed / (1 - g * (1 - absorbed)));
  return (1 - s) * (1 - HULST_A * s) / (1 + HULST_B * s);
}

static double hulst_absorbed(double colour, double g) {
  const double u = 1 + HULST_A + HULST_B * colour;
  const double s = (u - sqrt(u * u - 4 * HULST_A * (1 - colour))) / (2 * HULST_A);
  return s * s * (1 - g) / (1 - g * s * s);
}

/* Wrenninge, Villemin, Hery 2017, the same for index-matched media: a fit whose terms are polynomials
 * of g. It exceeds 1 near white; renderers take 1 - 1e-6 there. */
static double wrenninge_absorbed(double colour, double g) {
  static const double fits[][8] = {{1.8260523782, -1.28451056436, -1.79904629312, 9.19393289202,
                                    -22.8215585862, 32.0234874259, -23.6264803333, 7.21067002658},
                                   {0, 31.1491581433, -201.847017512, 841.576016723, -2018.09288505,
                                    2731.71560286, -1935.41424244, 559.009054474},
                                   {1.09686102424, -0.394704063468, 1.05258115941, -8.83963712726,
                                    28.8643230661, -46.8802913581, 38.5402837518, -12.7181042538},
                                   {0.496310210422, 0.360146581622, -2.15139309747, 17.8896899217,
                                    -55.2984010333, 82.065982243, -58.5106008578, 15.8478295021},
                                   {0, 76.7316253952, -594.356773233, 2448.8834203, -5576.68528998,
                                    7116.60171912, -4763.54467887, 1303.5318055},
                                   {2.40602999408, -2.51814844609, 9.18494908356, -79.2191708682,
                                    259.082868209, -403.613804597, 302.85712436, -87.4370473567}};
  double p[6] = {0};
  for (int i = 0; i < 6; i++) {
    for (int k = 7; k >= 0; k--) {
      p[i] = p[i] * g + fits[i][k];
    }
  }
  const double dark = p[0] * pow(atan((4.98511194385 + 0.127355959438 * exp(p[1])) * colour), p[2]);
  const double bright =
      p[3] * pow(atan((4.23190299701 + 0.00310603949088 * exp(p[4])) * colour), p[5]);
  const double share = pow(colour, 0.25);
  return fmin(fmax(1 - (1 - share) * dark - share * bright, 1e-6), 1);
}

/* Returns 1 - sigma_s / (sigma_a + sigma_s) of a colour by the formula of a kind. */
static double absorbed_by(enum colour_kind kind, double colour, double g) {
  return kind == WRENNINGE || kind == WRENNINGE_FREE
             ? wrenninge_absorbed(colour, g)
             : hulst_absorbed(colour, kind == HULST_G0 ? 0 : g);
}

/* Inverts absorbed_by(). */
static double colour_by(enum colour_kind kind, double absorbed, double g) {
  if (kind != WRENNINGE && kind != WRENNINGE_FREE) {
    return hulst_colour(absorbed, kind == HULST_G0 ? 0 : g);
  }
  double low = 0, high = 1;
  for (int step = 0; step < 60; step++) {
    const double middle = (low + high) / 2;
    *(wrenninge_absorbed(middle, g) > absorbed ? &low : &high) = middle;
  }
  return low;
}

/* Returns a convention's length over d of Burley's profile (Christensen, Burley 2015). */
static double per_burley(enum length_kind kind, double colour) {
  const double off = fabs(colour - 0.8);
  return kind == BLENDER  ? 4 * acos(-1)
         : kind == UNREAL ? 0.6 * (1.85 - colour + 7 * off * off * off)
                          : 1;
}

static double absorbed_of(const dipole_medium *medium) {
  return medium->sigma_a_per_mm / (medium->sigma_a_per_mm + medium->sigma_s_per_mm);
}

/* ---- requests -------------------------------------------------------------------------------- */

/* Sets colours[count] to the albedos of these media for a beam under a model. */
static bool find_colours(const material *of, unsigned model, const dipole_medium *media,
                         double *colours) {
  dipole_result *result;
  dipole_error error;
  dipole_query query;
  dipole_query_init(&query);
  query.model = model;
  query.evaluator = DIPOLE_F64;
  query.wanted = DIPOLE_ALBEDO;
  query.media = media;
  query.medium_count = (uint32_t)of->count;
  if (!CLI_RETRY(of->settings, &error, dipole_eval(of->client, &query, &result, &error))) {
    if (of->from != NULL && strcmp(error.field, "sigma_a") == 0) {
      return cli_fails("--colour: channel %llu is too dark for its g; allowed is sigma_a %s",
                       (unsigned long long)error.index + 1, error.allowed);
    }
    return cli_fail_error(&error) == CLI_OK;
  }
  for (size_t i = 0; i < of->count; i++) {
    colours[i] = result->channels[i].albedo;
  }
  dipole_result_free(result);
  return true;
}

/* Sets media[count], which have g and eta, to those of colours and lengths of the kind `given`. */
static bool find_media(const material *of, unsigned model, unsigned given, const double *colours,
                       const double *lengths_mm, dipole_medium *media) {
  for (size_t i = 0; i < of->count; i++) {
    dipole_inversion *found;
    dipole_error error;
    const dipole_invert_query query = {.model = model,
                                       .moments = DIPOLE_EXACT,
                                       .given = given,
                                       .g = media[i].g,
                                       .eta = media[i].eta,
                                       .albedos = &colours[i],
                                       .lengths_mm = &lengths_mm[i],
                                       .medium_count = 1};
    if (!CLI_RETRY(of->settings, &error, dipole_invert(of->client, &query, &found, &error))) {
      return cli_fail_error(&error) == CLI_OK;
    }
    media[i].sigma_a_per_mm = found->sigma_a_per_mm[0];
    media[i].sigma_s_per_mm = found->sigma_s_per_mm[0];
    const bool missing = found->missing_count > 0;
    dipole_inversion_free(found);
    if (missing) {
      return cli_fails("--colour: channel %zu: no medium has the colour %g and the length", i + 1,
                       colours[i]);
    }
  }
  return true;
}

/* Returns [count] media with an extinction of 1 / mm, whose albedos are by the formula of a kind. */
static dipole_medium *media_by(const material *of, enum colour_kind kind, const double *colours) {
  dipole_medium *media = cli_allocate(of->count, sizeof *media);
  for (size_t i = 0; i < of->count; i++) {
    const double absorbed = absorbed_by(kind, colours[i], of->media[i].g);
    media[i] = (dipole_medium){absorbed, 1 - absorbed, of->media[i].g,
                               kind >= HULST_FREE ? 1 : of->media[i].eta};
  }
  return media;
}

/* Sets shown[count] to what renderers with the formula of a kind show of colours that are typed.
 * Blender's walk, with van de Hulst's formula, is shown in a beam that is refracted on the way in
 * alone. Walks with Wrenninge's formula are shown in diffuse light, where van de Hulst's formula is
 * right within .002. */
static bool find_shown(const material *of, enum colour_kind kind, const double *colours,
                       double *shown) {
  const dipole_medium *media = media_by(of, kind, colours);
  for (size_t i = 0; i < of->count && kind == WRENNINGE_FREE; i++) {
    shown[i] = hulst_colour(media[i].sigma_a_per_mm, media[i].g);
  }
  return kind == WRENNINGE_FREE || find_colours(of, CORE_MODEL_TRANSPORT, media, shown);
}

/* Returns [count] lengths of 1 mm. */
static double *one_mm(const material *of) {
  double *lengths_mm = cli_allocate(of->count, sizeof *lengths_mm);
  for (size_t i = 0; i < of->count; i++) {
    lengths_mm[i] = 1;
  }
  return lengths_mm;
}

/* Sets ratios[count] to the length of SKIN of media over 1 / (sigma_a + sigma_s). Random Walk (Skin)
 * takes it for 1 / sqrt(3 sigma_a sigma_t') of a classical dipole of the colour, and sigma_t' / (1 -
 * g) for the extinction. */
static bool skin_ratios(const material *of, const double *colours, double *ratios) {
  dipole_medium *media = cli_allocate(of->count, sizeof *media);
  memcpy(media, of->media, of->count * sizeof *media);
  if (!find_media(of, CORE_MODEL_CLASSICAL, DIPOLE_CLASSICAL_DIFFUSE_PATH, colours, one_mm(of),
                  media)) {
    return false;
  }
  for (size_t i = 0; i < of->count; i++) {
    const double g = media[i].g;
    ratios[i] = (media[i].sigma_a_per_mm + media[i].sigma_s_per_mm * (1 - g)) / (1 - g);
  }
  return true;
}

/* Multiplies the coefficients of a medium by a factor, which divides its lengths by it. */
static void scale_medium(dipole_medium *medium, double by) {
  medium->sigma_a_per_mm *= by;
  medium->sigma_s_per_mm *= by;
}

/* ---- from a convention ----------------------------------------------------------------------- */

static bool read_numbers(material *of) {
  const cli_settings *settings = of->settings;
  const cli_numbers *lengths = &settings->length;
  const double unit_mm = of->from->unit_mm > 0 ? of->from->unit_mm : of->unit_mm;
  double *lengths_mm = cli_allocate(of->count, sizeof *lengths_mm);
  for (size_t i = 0; i < of->count; i++) {
    const double colour = settings->colour.items[i];
    of->typed[i] = settings->srgb ? cli_srgb_to_linear(colour) : colour;
    lengths_mm[i] = unit_mm * lengths->items[lengths->count == 1 ? 0 : i];
  }
  const enum colour_kind kind = of->from->colour;
  if (kind == CLASSICAL) {
    return find_media(of, CORE_MODEL_CLASSICAL, DIPOLE_CLASSICAL_DIFFUSE_PATH, of->typed,
                      lengths_mm, of->media);
  }
  if (kind >= HULST && kind < HULST_FREE) {
    of->media = media_by(of, kind, of->typed);
    for (size_t i = 0; i < of->count; i++) {
      scale_medium(&of->media[i], 1 / lengths_mm[i]);
    }
    return true;
  }
  double *ratios = one_mm(of), *r_mm = NULL, *wanted = of->typed;
  if (kind >= HULST_FREE) {
    wanted = cli_allocate(of->count, sizeof *wanted);
    if (!find_shown(of, kind, of->typed, wanted)) {
      return false;
    }
  }
  /* The scale is the wanted length over that of the medium with an extinction of 1 / mm. */
  if (!find_media(of, CORE_MODEL_TRANSPORT, DIPOLE_EXTINCTION_PATH, wanted, ratios, of->media) ||
      (of->from->length == SKIN && !skin_ratios(of, of->typed, ratios)) ||
      (of->from->length >= BURLEY &&
       !cli_edge_radii(of->settings, of->client, of->media, 1, of->count, &r_mm, NULL, NULL))) {
    return false;
  }
  for (size_t i = 0; i < of->count; i++) {
    const double ratio = of->from->length >= BURLEY
                             ? cli_edge_burley(r_mm + i * CLI_EDGE_RADII, NULL) *
                                   per_burley(of->from->length, of->typed[i])
                             : ratios[i];
    scale_medium(&of->media[i], ratio / lengths_mm[i]);
  }
  return true;
}

/* ---- to a convention ------------------------------------------------------------------------- */

/* Needs of->shown. */
static bool set_colours(material *of) {
  const enum colour_kind kind = of->settings->typed ? HULST : of->to->colour;
  dipole_medium *media = of->media;
  if (kind == SMOOTH) {
    memcpy(of->colours, of->shown, of->count * sizeof *of->colours);
    return true;
  }
  if (kind == CLASSICAL) {
    return find_colours(of, CORE_MODEL_CLASSICAL, media, of->colours);
  }
  if (kind == HULST_FREE) { /* media that show these colours without an interface */
    media = media_by(of, kind, of->shown);
    if (!find_media(of, CORE_MODEL_TRANSPORT, DIPOLE_EXTINCTION_PATH, of->shown, one_mm(of),
                    media)) {
      return false;
    }
  }
  for (size_t i = 0; i < of->count; i++) {
    const double g = media[i].g;
    const double absorbed =
        kind == WRENNINGE_FREE ? hulst_absorbed(of->shown[i], g) : absorbed_of(&media[i]);
    of->colours[i] = colour_by(kind, absorbed, g);
  }
  return true;
}

static bool set_lengths(material *of) {
  const double unit_mm = of->to->unit_mm > 0 ? of->to->unit_mm : of->unit_mm;
  const enum length_kind kind = of->to->length;
  double *ratios = one_mm(of), *r_mm = NULL;
  if (kind == SKIN && !skin_ratios(of, of->colours, ratios)) {
    return false;
  }
  if (kind >= BURLEY &&
      !cli_edge_radii(of->settings, of->client, of->media, 1, of->count, &r_mm, NULL, NULL)) {
    return false;
  }
  for (size_t i = 0; i < of->count; i++) {
    const dipole_medium *medium = &of->media[i];
    const double path_mm = 1 / (medium->sigma_a_per_mm + medium->sigma_s_per_mm);
    const double reduced = medium->sigma_a_per_mm + medium->sigma_s_per_mm * (1 - medium->g);
    const double length_mm =
        kind == CLASSICAL_LENGTH ? 1 / sqrt(3 * medium->sigma_a_per_mm * reduced)
        : kind < BURLEY
            ? path_mm * ratios[i]
            : cli_edge_burley(r_mm + i * CLI_EDGE_RADII, NULL) * per_burley(kind, of->colours[i]);
    of->lengths[i] = length_mm / unit_mm;
  }
  return true;
}

/* Sets what the target shows of the given colours. */
static bool set_shown_as_given(material *of) {
  return of->to == NULL || of->from == NULL || (!of->settings->typed && of->to->colour < HULST) ||
         find_shown(of, of->settings->typed ? HULST : of->to->colour, of->typed,
                    of->shown_as_given);
}

/* ---- writing --------------------------------------------------------------------------------- */

static const char *name_of(const convention *of) {
  return of != NULL ? of->name : COEFFICIENTS;
}

static void put_facts(cli_rows *rows, const void *context) {
  const material *of = context;
  cli_put_text(rows, name_of(of->from), "from");
  cli_put_text(rows, name_of(of->to), "to");
  if (of->to != NULL) {
    cli_put_text(rows, of->to->source, "source", "as in");
  }
  if (of->to != NULL && of->to->note[0] != '\0') {
    cli_put_text(rows, of->to->note, "note");
  }
}

static void put_channel(cli_rows *rows, const void *context, size_t i) {
  const material *of = context;
  const dipole_medium *medium = &of->media[i];
  cli_put_count(rows, i + 1, "channel");
  if (of->to != NULL) {
    cli_put_number(rows, of->colours[i], "colour");
    cli_put_number(rows, of->lengths[i], "length");
  }
  cli_put_medium(rows, medium, 1);
  cli_put_number(rows, 1 - absorbed_of(medium), "scattered");
  cli_put_number(rows, of->shown[i], "shown", "shows");
  cli_put_number(rows, of->shown_as_given[i], "shown_as_given", "as given", .missing = "-");
}

static void write_three(const native_form *form, const char *name, const double *values) {
  printf(form->three, name, values[0], values[1], values[2]);
}

/* Writes a glTF material. Its extensions state the extinction by a transmitted colour and the
 * distance at which light has this colour. */
static void write_gltf(const material *of, const char *colour, double factor,
                       const double *lengths) {
  printf("{\"extensions\": {\n  \"%s\": {\"%s\": [%.9g, %.9g, %.9g], \"scatterAnisotropy\": "
         "%.9g%s},\n",
         of->to->form->element, colour, of->colours[0], of->colours[1], of->colours[2],
         of->media[0].g, of->to->form == &form_GLTF ? ", \"scatterStrengthFactor\": 1" : "");
  printf("  \"KHR_materials_volume\": {\"attenuationDistance\": %.9g, \"attenuationColor\": [%.9g, "
         "%.9g, %.9g]},\n  \"KHR_materials_ior\": {\"ior\": %.9g}}}\n",
         factor, exp(-1 / lengths[0]), exp(-1 / lengths[1]), exp(-1 / lengths[2]),
         of->media[0].eta);
}

/* Sets the names of a convention's parameters; "" where it has none. Unless `usual` is NULL, sets
 * their defaults in files; NULL where a file has to give the value. */
static void take_names(const convention *of, const char *names[NAMES], const char *usual[NAMES]) {
  char *list = cli_copy(of->names, strlen(of->names));
  for (size_t i = 0; i < NAMES; i++) {
    char *value = strsep(&list, ",");
    names[i] = strsep(&value, "=");
    if (usual != NULL) {
      usual[i] = value;
    }
  }
}

static bool is_gltf(const convention *of) {
  return of->form == &form_GLTF || of->form == &form_GLTF_DRAFT;
}

/* Returns CLI_OK if native forms can say the media: three channels of one g and eta. */
static int check_native(const material *of) {
  bool one = true;
  for (size_t i = 1; i < of->count; i++) {
    one = one && of->media[i].g == of->media[0].g && of->media[i].eta == of->media[0].eta;
  }
  return of->count != CLI_COLOURS
             ? cli_fail_usage("--format native: give three channels, not %zu", of->count)
         : !one ? cli_fail_usage("--format native: one g and eta for all channels")
                : CLI_OK;
}

/* Writes the parameters in the form in which the target's users enter them. */
static void write_native(const material *of) {
  const native_form *form = of->to->form;
  const char *names[NAMES];
  take_names(of->to, names, NULL);
  const bool split = names[NAME_FACTOR][0] != '\0';
  const double most = fmax(of->lengths[0], fmax(of->lengths[1], of->lengths[2]));
  const double factor = split ? most : 1;
  const double lengths[] = {of->lengths[0] / factor, of->lengths[1] / factor,
                            of->lengths[2] / factor};
  if (is_gltf(of->to)) {
    write_gltf(of, names[NAME_COLOUR], factor, lengths);
    return;
  }
  printf(form->first, form->element);
  write_three(form, names[NAME_COLOUR], of->colours);
  write_three(form, names[NAME_LENGTHS], lengths);
  const double numbers[] = {
      [NAME_FACTOR] = factor, [NAME_G] = of->media[0].g, [NAME_ETA] = of->media[0].eta};
  for (size_t i = NAME_FACTOR; i < NAMES; i++) {
    if (names[i][0] != '\0') {
      printf(form->one, names[i], numbers[i]);
    }
  }
  printf(form->last, form->element);
}

/* Reports what the source does not state, and what the target cannot express. */
static void tell_notes(const material *of) {
  const char *names[NAMES];
  if (of->from != NULL && of->from->note[0] != '\0') {
    cli_say(CLI_OK, "--from %s: %s", of->from->name, of->from->note);
  }
  if (of->to == NULL) {
    return;
  }
  take_names(of->to, names, NULL);
  if (names[NAME_G][0] == '\0' && fabs(of->media[0].g) > 0) {
    cli_say(CLI_OK, "%s cannot say g: its length is that of g %g", of->to->name, of->media[0].g);
  }
  if (names[NAME_ETA][0] == '\0') {
    cli_say(CLI_OK, "%s cannot say the index, %g", of->to->name, of->media[0].eta);
  }
  if (of->to->length >= BURLEY) {
    cli_say(CLI_OK,
            "%s has Burley's profile alone: the length is that whose shadow edge is the nearest",
            of->to->name);
  }
}

/* ---- the command ----------------------------------------------------------------------------- */

/* Finds a convention by name. *found is NULL for coefficients. Reports an error and returns false
 * if the name is unknown. */
static bool find_convention(const char *option, const char *name, const convention **found) {
  char known[512] = COEFFICIENTS;
  *found = NULL;
  for (size_t i = 0; i < CONVENTIONS; i++) {
    if (strcmp(conventions[i].name, name) == 0) {
      *found = &conventions[i];
    }
    snprintf(known + strlen(known), sizeof known - strlen(known), ", %s", conventions[i].name);
  }
  if (*found == NULL && strcmp(name, COEFFICIENTS) != 0) {
    return cli_fails_usage("--%s: '%s' is unknown; there are %s", option, name, known);
  }
  return true;
}

/* Sets numbers to the values of a parameter. Returns false if it is not there. */
static bool take_values(const cli_material *of, const char *name, cli_numbers *numbers) {
  size_t count = 0;
  const double *values = cli_material_find(of, name, &count);
  *numbers = (cli_numbers){count, cli_allocate(3, sizeof *values)};
  if (values != NULL) {
    memcpy(numbers->items, values, count * sizeof *values);
  }
  return values != NULL;
}

/* Reads FILE and sets what no option gives. Says what is wrong and returns false. */
static bool read_file(cli_settings *settings, const convention *from) {
  static const char *const options_of[NAMES] = {"colour", "length", "length", "g", "eta"};
  static cli_material read;
  cli_numbers factor = {0}, strength = {0};
  cli_numbers *const numbers[NAMES] = {&settings->colour, &settings->length, &factor, &settings->g,
                                       &settings->eta};
  const char *file = settings->operand, *names[NAMES], *usual[NAMES];
  const native_form *form = from->form;
  const bool has_colour = settings->colour.count > 0, has_length = settings->length.count > 0;
  if (form != &form_PBRT && form->element == NULL) {
    return cli_fails_usage("%s: files are read --from openpbr, materialx, standard-surface, gltf, "
                           "gltf-volume-scatter and pbrt",
                           file);
  }
  if (!(is_gltf(from)        ? cli_material_read_gltf(file, form->element, &read)
        : form == &form_PBRT ? cli_material_read_pbrt(file, &read)
                             : cli_material_read_mtlx(file, form->element, &read))) {
    return false;
  }
  take_names(from, names, usual);
  for (size_t i = 0; i < NAMES; i++) {
    if (names[i][0] == '\0' || numbers[i]->count > 0 || (i == NAME_FACTOR && has_length)) {
      continue;
    }
    if (usual[i] != NULL) {
      cli_material_add(&read, names[i], usual[i]);
    }
    if (!take_values(&read, names[i], numbers[i])) {
      return cli_fails("%s: it has no %s: give --%s", file, names[i], options_of[i]);
    }
    if (numbers[i]->count == 0) {
      return cli_fails("%s: %s is connected to a node, or is no number: give --%s", file, names[i],
                       options_of[i]);
    }
  }
  for (size_t i = 0; i < settings->length.count && !has_length; i++) {
    double *length = &settings->length.items[i];
    *length =
        (is_gltf(from) ? -1 / log(*length) : *length) * (factor.count > 0 ? factor.items[0] : 1);
  }
  take_values(&read, "scatterStrengthFactor", &strength);
  for (size_t i = 0; i < settings->colour.count && strength.count > 0 && !has_colour; i++) {
    settings->colour.items[i] *= strength.items[0];
  }
  return true;
}

static bool is_native(const cli_settings *settings) {
  return settings->format != NULL && strcmp(settings->format, "native") == 0;
}

static int check(cli_settings *settings) {
  const convention *from, *to;
  if (settings->source == NULL) {
    return cli_fail_usage("give --from: a convention, or " COEFFICIENTS);
  }
  if (!find_convention("from", settings->source, &from) ||
      !find_convention("to", settings->target, &to) || isnan(cli_unit_mm(settings))) {
    return CLI_USAGE;
  }
  if (settings->unit != NULL && (from == NULL || from->unit_mm > 0) &&
      (to == NULL || to->unit_mm > 0)) {
    return cli_fail_usage("--unit: the lengths of %s and %s have units of their own: leave it out",
                          name_of(from), name_of(to));
  }
  if (is_native(settings) && (to == NULL || to->form == &form_NONE)) {
    return cli_fail_usage("--format native: %s has none; take json or csv", name_of(to));
  }
  if (from == NULL) {
    return cli_medium_check(settings);
  }
  if (settings->operand != NULL && !read_file(settings, from)) {
    return CLI_FAILED;
  }
  if (settings->colour.count == 0 ||
      (settings->length.count != 1 && settings->length.count != settings->colour.count)) {
    return cli_fail_usage("give --colour, and --length for all or each of its channels");
  }
  for (size_t i = 0; i < settings->colour.count; i++) {
    if (!(settings->colour.items[i] >= 0 && settings->colour.items[i] <= 1)) {
      return cli_fail_usage("--colour: %g is not from 0 to 1%s", settings->colour.items[i],
                            settings->colour.items[i] > 1 ? ": divide values of 8 bits by 255"
                                                          : "");
    }
  }
  for (size_t i = 0; i < settings->length.count; i++) {
    if (!(settings->length.items[i] > 0 && settings->length.items[i] < INFINITY)) {
      return cli_fail_usage("--length: %g is not more than 0 and finite",
                            settings->length.items[i]);
    }
  }
  const cli_numbers *const shared[] = {&settings->g, &settings->eta};
  for (size_t i = 0; i < sizeof shared / sizeof *shared; i++) {
    if (shared[i]->count > 1 && shared[i]->count != settings->colour.count) {
      return cli_fail_usage("--g, --eta: one for all channels, or one for each");
    }
  }
  return settings->medium.count > 0 || settings->sigma_a.count > 0 || settings->sigma_s.count > 0
             ? cli_fail_usage("--medium, --sigma-a, --sigma-s: these are of --from " COEFFICIENTS)
             : CLI_OK;
}

static int run_convert(const cli_settings *settings, dipole_client *client) {
  material of = {.settings = settings, .client = client, .unit_mm = cli_unit_mm(settings)};
  cli_profile profile = {0};
  find_convention("from", settings->source, &of.from);
  find_convention("to", settings->target, &of.to);
  if (of.from == NULL) {
    const int status = cli_profile_take(settings, client, &profile);
    if (status != CLI_OK) {
      return status;
    }
  }
  of.count = of.from == NULL ? profile.channel_count : settings->colour.count;
  of.media = of.from == NULL ? profile.media : cli_allocate(of.count, sizeof *of.media);
  double **const arrays[] = {&of.colours, &of.lengths, &of.typed, &of.shown, &of.shown_as_given};
  for (size_t k = 0; k < sizeof arrays / sizeof arrays[0]; k++) {
    *arrays[k] = cli_allocate(of.count, sizeof **arrays[k]);
    for (size_t i = 0; i < of.count; i++) {
      (*arrays[k])[i] = NAN;
    }
  }
  for (size_t i = 0; i < of.count && of.from != NULL; i++) {
    of.media[i].g = cli_numbers_pick(&settings->g, i, 0);
    of.media[i].eta = cli_numbers_pick(&settings->eta, i, 1.5);
  }
  const convention *const both[] = {of.from, of.to};
  for (size_t k = 0; k < 2 * of.count; k++) {
    const convention *one = both[k % 2];
    if (one != NULL && (one->colour == WRENNINGE || one->colour == WRENNINGE_FREE) &&
        of.media[k / 2].g < 0) {
      return cli_fail_usage("--g: the formula of %s is for g from 0 on", one->name);
    }
  }
  if (is_native(settings)) {
    const int status = check_native(&of);
    if (status != CLI_OK) {
      return status;
    }
  }
  if ((of.from != NULL && !read_numbers(&of)) ||
      !find_colours(&of, CORE_MODEL_TRANSPORT, of.media, of.shown) ||
      (of.to != NULL && !(set_colours(&of) && set_lengths(&of))) || !set_shown_as_given(&of)) {
    return CLI_FAILED;
  }
  tell_notes(&of);
  if (is_native(settings)) {
    write_native(&of);
    return CLI_OK;
  }
  const cli_report output = {.facts = put_facts, .rows = of.count, .put_row = put_channel};
  cli_write(&output, settings->form, &of);
  return CLI_OK;
}

const cli_command cli_command_convert = {
    .name = "convert",
    .operand = "[FILE]",
    .about = "Convert colours and lengths between renderers, and to coefficients",
    .more =
        "A renderer makes a medium of a colour and a length; each means something else by them. "
        "`shows` is the colour that light at normal incidence gets back from the medium through "
        "its interface, per power that entered; `as given` is the same if the colours are typed "
        "into the target unconverted. Renderers' formulas are evaluated exactly; what is shown, "
        "and media that show a colour, are those of transport, whose albedo is within 2e-5. "
        "Colours that are written are linear. FILE is a .mtlx, the JSON of a glTF or of its "
        "extensions, or a material of pbrt, and gives what no option does; without --eta the index "
        "is that of the file, or 1.5. --format native writes .mtlx, JSON of glTF, a line of pbrt, "
        "lines of Python for Blender and Unreal, or values of a Unity asset. The conventions:"
#undef CONVENTION
#define CONVENTION(name, COLOUR, LENGTH, unit_mm, FORM, names, source, note) "\n" name ": " source
#include "clients/cli/conventions.def"
    ,
    .formats = "table,csv,json,native",
    .options = {options, cli_medium_options},
    .check = check,
    .run = run_convert,
    .examples =
        "  dipole convert --from openpbr --colour .8,.5,.3 --length 1,.5,.25 --eta 1.5\n"
        "  dipole convert --from openpbr --colour .8,.5,.3 --length 1,.5,.25 --to openpbr --typed\n"
        "  dipole convert --from coefficients --medium skin1 --to unity --format native\n",
};
