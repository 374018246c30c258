/* dipole bake: kernels, lengths and tables of a medium for engines, each with its error. */
#include <math.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

#include "clients/cli/edge.h"
#include "clients/cli/image.h"
#include "clients/cli/options.h"
#include "clients/cli/profile.h"
#include "core/varying.h"

enum {
  TAPS_MIN = 11,
  TAPS_MAX = 33,
  SIDE_MIN = 16,
  SIDE_MAX = 4096,
  SPHERE_MAX = 128,
  COLUMNS_MAX = 7
};

static const cli_option options[] = {
    CLI_TITLE("What is baked"),
    CLI_OPTION(COUNT, taps, "25", "of kernel: number of taps, odd, 11 to 33"),
    CLI_OPTION(
        NUMBERS, range, NULL,
        "of kernel: distance of the last tap, mm, one for all or each channel (default: that "
        "with the least error); of profile: where it ends, mm (default: .995 of the light of each "
        "channel lies within)"),
    CLI_OPTION(SWITCH, common, NULL,
               "of kernel: one range for all channels, the largest, so that a tap is a float4 of "
               "three weights and an offset"),
    CLI_OPTION(COUNT, count, "6", "of gaussians: how many, 2 to 12"),
    CLI_OPTION(COUNT, size, "64",
               "of lut: numbers along each axis; of colour-map: colours; of profile: radii"),
    CLI_OPTION(TEXT, light, "beam",
               "of colour-map and formula: the light of the colours, beam or diffuse"),
    {0},
};

/* A fact about each channel, or about all (channels 1), that a file states. */
typedef struct fact {
  const char *name, *about;
  double values[CLI_COLOURS];
} fact;

enum { FACTS_MAX = 5 * CORE_LAYERS_MAX + 8 };

/* What is written into files: rows of numbers, and facts. */
typedef struct sheet {
  const char *kind;
  size_t rows, columns, channels;
  const char *names[COLUMNS_MAX];
  double *values; /* [rows][columns] */
  /* of a picture: pixels in a line, and the first column with colours. Three columns are red, green
   * and blue of all pixels; the next three are another picture below */
  size_t width, pixels_from;
  size_t fact_count;
  fact facts[FACTS_MAX];
} sheet;

typedef struct bake {
  const cli_settings *settings;
  dipole_client *client;
  cli_profile profile;
  dipole_medium *media; /* [CLI_COLOURS][profile.layer_count] */
  double *r_mm;         /* [channels][CLI_EDGE_RADII] of cli_edge_radii() */
  sheet sheet;
} bake;

static void add_fact(sheet *of, const char *name, const char *about, const double *values) {
  fact *one = &of->facts[of->fact_count++];
  *one = (fact){.name = name, .about = about};
  memcpy(one->values, values, of->channels * sizeof *values);
}

static void set_rows(sheet *of, size_t rows, size_t columns, const char *const *names) {
  of->rows = rows;
  of->columns = columns;
  of->values = cli_allocate(rows * columns, sizeof *of->values);
  memcpy(of->names, names, columns * sizeof *names);
}

static const double *radii_of(const bake *of, size_t channel) {
  return of->r_mm + channel * CLI_EDGE_RADII;
}

/* ---- kernel ---------------------------------------------------------------------------------- */

/* Taps of a separable blur at offsets range o |o|, o from -1 to 1 in equal steps (Jimenez et al.
 * 2015). A tap stands for the light up to half the way to its neighbours, the last one for all
 * beyond: its weight is the difference of E between these places. */
typedef struct taps {
  size_t count;
  double range_mm;
  double offsets[TAPS_MAX];
  /* ends of the taps' bins; the first and last bin are symmetric about their tap */
  double ends[TAPS_MAX + 1];
  double edge[TAPS_MAX + 1]; /* E at these ends; 0 at the first, 1 at the last */
} taps;

static void lay_taps(const double *r_mm, size_t count, double range_mm, taps *of) {
  of->count = count;
  of->range_mm = range_mm;
  for (size_t i = 0; i < count; i++) {
    const double o = 2 * (double)i / (double)(count - 1) - 1;
    of->offsets[i] = range_mm * o * fabs(o);
  }
  for (size_t i = 1; i < count; i++) {
    of->ends[i] = 0.5 * (of->offsets[i - 1] + of->offsets[i]);
    of->edge[i] = cli_edge_at(r_mm, of->ends[i]);
  }
  of->ends[0] = 2 * of->offsets[0] - of->ends[1];
  of->ends[count] = -of->ends[0];
  of->edge[0] = 0;
  of->edge[count] = 1;
}

/* Returns the largest difference between E and the edge that the kernel gives, if each tap spreads
 * its light evenly over its bin, at `parts` places in each bin. */
static double edge_error(const double *r_mm, const taps *of, int parts) {
  double worst = 1 - cli_edge_at(r_mm, of->ends[of->count]);
  for (size_t i = of->count / 2; i < of->count; i++) {
    for (int k = 0; k < parts; k++) {
      const double share = (double)k / parts;
      const double x = of->ends[i] + share * (of->ends[i + 1] - of->ends[i]);
      const double kernel = of->edge[i] + share * (of->edge[i + 1] - of->edge[i]);
      worst = fmax(worst, fabs(kernel - cli_edge_at(r_mm, x)));
    }
  }
  return worst;
}

/* Returns the range with the smallest error among RANGES values in equal ratios. */
static double best_range(const double *r_mm, size_t count) {
  enum { RANGES = 80 };
  const double least = r_mm[CLI_EDGE_RADII / 2];
  double best = least, best_error = 1;
  taps tried;
  for (int i = 0; i < RANGES; i++) {
    lay_taps(r_mm, count, least * pow(40, (double)i / RANGES), &tried);
    const double error = edge_error(r_mm, &tried, 8);
    best = error < best_error ? tried.range_mm : best;
    best_error = fmin(error, best_error);
  }
  return best;
}

static int make_kernel(bake *of) {
  static const char *const names[] = {"weight_red", "weight_green", "weight_blue",
                                      "offset_red", "offset_green", "offset_blue"};
  static const char *const common_names[] = {"weight_red", "weight_green", "weight_blue", "offset"};
  const cli_settings *settings = of->settings;
  sheet *const made = &of->sheet;
  const size_t count = settings->taps.value;
  const bool common = settings->common;
  double ranges[CLI_COLOURS], most = 0, errors[CLI_COLOURS], steps[CLI_COLOURS],
                              beyond[CLI_COLOURS];
  set_rows(made, count, common ? 4 : 6, common ? common_names : names);
  for (size_t i = 0; i < CLI_COLOURS; i++) {
    ranges[i] = settings->range.count > 0 ? cli_numbers_pick(&settings->range, i, 0)
                                          : best_range(radii_of(of, i), count);
    most = fmax(most, ranges[i]);
  }
  for (size_t i = 0; i < CLI_COLOURS; i++) {
    const double *r_mm = radii_of(of, i);
    taps laid;
    lay_taps(r_mm, count, common ? most : ranges[i], &laid);
    ranges[i] = laid.range_mm;
    errors[i] = edge_error(r_mm, &laid, 128) + CLI_EDGE_ERROR;
    beyond[i] = 2 * (1 - cli_edge_at(r_mm, laid.ends[count]));
    steps[i] = 0;
    for (size_t k = 0; k < count; k++) {
      const double weight = laid.edge[k + 1] - laid.edge[k];
      made->values[k * made->columns + i] = weight;
      made->values[k * made->columns + (common ? 3 : 3 + i)] = laid.offsets[k];
      steps[i] = fmax(steps[i], weight);
    }
  }
  add_fact(made, "range_mm", "offset of the last tap", ranges);
  add_fact(
      made, "edge_error",
      "largest error beside a straight shadow edge, of the light inside, if taps take the light "
      "of their bins (half the way to each neighbour)",
      errors);
  add_fact(made, "step", "largest step if an edge is sharper than the taps lie apart", steps);
  add_fact(made, "beyond", "share of the light beyond the taps' bins, which the last taps take",
           beyond);
  return CLI_OK;
}

/* ---- Burley's profile ------------------------------------------------------------------------ */

static int make_burley(bake *of) {
  static const char *const names[] = {"d_red", "d_green", "d_blue"};
  double errors[CLI_COLOURS];
  set_rows(&of->sheet, 1, CLI_COLOURS, names);
  for (size_t i = 0; i < CLI_COLOURS; i++) {
    of->sheet.values[i] = cli_edge_burley(radii_of(of, i), &errors[i]);
  }
  add_fact(&of->sheet, "edge_error",
           "largest error beside a straight shadow edge, of the light inside", errors);
  return CLI_OK;
}

/* ---- Gaussians ------------------------------------------------------------------------------- */

enum { GAUSSIANS_MIN = 2, GAUSSIANS_MAX = 12 };

/* Fits the shares and variances of Gaussians to radii by expectation and maximization (Dempster,
 * Laird, Rubin 1977): a Gaussian of variance v has the density r / v e^(-r^2 / 2 v) of radii. Shares
 * stay positive, and their sum 1. */
static void fit_gaussians(const double *r_mm, size_t count, double shares[], double variances[]) {
  enum { ROUNDS = 300, EVERY = 4 }; /* one of EVERY radii is used, which is enough */
  const double least = r_mm[CLI_EDGE_RADII / 20], most = r_mm[CLI_EDGE_RADII - CLI_EDGE_RADII / 50];
  for (size_t k = 0; k < count; k++) {
    const double width = least * pow(most / least, (double)k / (double)(count - 1));
    shares[k] = 1 / (double)count;
    variances[k] = width * width / 2;
  }
  for (int round = 0; round < ROUNDS; round++) {
    double sums[GAUSSIANS_MAX] = {0}, squares[GAUSSIANS_MAX] = {0}, all = 0;
    for (size_t i = EVERY / 2; i < CLI_EDGE_RADII; i += EVERY) {
      const double half = r_mm[i] * r_mm[i] / 2;
      double parts[GAUSSIANS_MAX], sum = 0;
      for (size_t k = 0; k < count; k++) {
        parts[k] = shares[k] / variances[k] * exp(-half / variances[k]);
        sum += parts[k];
      }
      for (size_t k = 0; k < count && sum > 0; k++) {
        sums[k] += parts[k] / sum;
        squares[k] += parts[k] / sum * half;
      }
      all += sum > 0;
    }
    for (size_t k = 0; k < count; k++) {
      shares[k] = sums[k] / all;
      variances[k] = sums[k] > 0 ? squares[k] / sums[k] : variances[k];
    }
  }
}

static int make_gaussians(bake *of) {
  static const char *const names[] = {"share_red",    "share_green",    "share_blue",
                                      "variance_red", "variance_green", "variance_blue"};
  const size_t count = of->settings->count.value;
  double shares[GAUSSIANS_MAX], variances[GAUSSIANS_MAX], errors[CLI_COLOURS] = {0};
  set_rows(&of->sheet, count, 6, names);
  for (size_t i = 0; i < CLI_COLOURS; i++) {
    const double *r_mm = radii_of(of, i);
    fit_gaussians(r_mm, count, shares, variances);
    for (size_t k = 0; k < count; k++) {
      of->sheet.values[6 * k + i] = shares[k];
      of->sheet.values[6 * k + 3 + i] = variances[k];
    }
    /* places are dense next to the edge, where many Gaussians err most, and far from it */
    for (size_t j = 0; j < CLI_EDGE_RADII;
         j += 1 + (j < CLI_EDGE_RADII / 2 ? j : CLI_EDGE_RADII - j) / 64) {
      double edge = 0.5;
      for (size_t k = 0; k < count; k++) {
        edge += 0.5 * shares[k] * erf(r_mm[j] / sqrt(2 * variances[k]));
      }
      errors[i] = fmax(errors[i], fabs(edge - cli_edge_at(r_mm, r_mm[j])) + CLI_EDGE_ERROR);
    }
  }
  add_fact(&of->sheet, "edge_error",
           "largest error beside a straight shadow edge, of the light inside", errors);
  return CLI_OK;
}

/* ---- the sphere ------------------------------------------------------------------------------ */

/* Returns the light that leaves a sphere where the cosine of the incident light's angle is `mu`,
 * over what leaves a plane where that is 1. On a sphere the area within a chord is
 * that within the same radius of a plane, so that each chord has its share. The mean of the light
 * over a ring, A + B cos phi where that is positive, is known. */
static double sphere_at(const double *r_mm, double radius_mm, double mu) {
  const double pi = acos(-1), sine = sqrt(fmax(0, 1 - mu * mu));
  double sum = 0;
  size_t count = 0;
  for (; count < CLI_EDGE_RADII && r_mm[count] < 2 * radius_mm; count++) {
    const double half = r_mm[count] / (2 * radius_mm), turned = 1 - 2 * half * half;
    const double A = mu * turned, B = sine * 2 * half * sqrt(1 - half * half);
    const double phi = A >= B ? pi : A <= -B ? 0 : acos(-A / B);
    sum += (A * phi + B * sin(phi)) / pi;
  }
  return count > 0 ? sum / (double)count : 0;
}

static int make_lut(bake *of) {
  static const char *const names[] = {"n_dot_l", "curvature_per_mm", "red", "green", "blue"};
  const size_t size = of->settings->size.value;
  double errors[CLI_COLOURS] = {0};
  set_rows(&of->sheet, size * size, 5, names);
  of->sheet.width = size;
  of->sheet.pixels_from = 2;
  for (size_t k = 0; k < size; k++) {
    const double curvature = ((double)k + 0.5) / (double)size; /* 1/mm */
    for (size_t i = 0; i < size; i++) {
      double *row = of->sheet.values + (k * size + i) * 5;
      row[0] = 2 * ((double)i + 0.5) / (double)size - 1;
      row[1] = curvature;
      for (size_t c = 0; c < CLI_COLOURS; c++) {
        row[2 + c] = sphere_at(radii_of(of, c), 1 / curvature, row[0]);
      }
    }
  }
  /* Where a sampler interpolates: half the way to the next texel along one axis or both. */
  for (size_t k = 0; k < size; k++) {
    for (size_t i = 0; i < size; i++) {
      for (int way = 1; way < 4; way++) {
        const size_t along = way & 1, across = (way >> 1) & 1;
        if (i + along < size && k + across < size) {
          const double *row = of->sheet.values + (k * size + i) * 5;
          const double *side = row + 5 * along, *up = row + 5 * size * across;
          const double *last = up + 5 * along;
          for (size_t c = 0; c < CLI_COLOURS; c++) {
            const double mean = 0.25 * (row[2 + c] + side[2 + c] + up[2 + c] + last[2 + c]);
            const double at =
                sphere_at(radii_of(of, c), 2 / (row[1] + up[1]), 0.5 * (row[0] + side[0]));
            errors[c] = fmax(errors[c], fabs(mean - at));
          }
        }
      }
    }
  }
  add_fact(&of->sheet, "value_error", "largest error half the way between texels, interpolated",
           errors);
  return CLI_OK;
}

/* ---- profile --------------------------------------------------------------------------------- */

/* Radii grow with the square, as R falls: a texel has the radius range u^2 at its middle u. */
static int make_profile(bake *of) {
  static const char *const names[] = {"r_mm",    "R_red",     "R_green", "R_blue",
                                      "cdf_red", "cdf_green", "cdf_blue"};
  static const unsigned quantities[] = {DIPOLE_R, DIPOLE_CDF};
  const size_t size = of->settings->size.value, fine = 2 * size - 1;
  double *r_mm = cli_allocate(fine, sizeof *r_mm), errors[2][CLI_COLOURS] = {{0}};
  double range_mm = cli_numbers_pick(&of->settings->range, 0, 0), beyond[CLI_COLOURS];
  dipole_result *result;
  dipole_error error;
  dipole_query query;
  for (size_t i = 0; i < CLI_COLOURS && of->settings->range.count == 0; i++) {
    range_mm = fmax(range_mm, radii_of(of, i)[CLI_EDGE_RADII - CLI_EDGE_RADII / 200]);
  }
  for (size_t i = 0; i < fine; i++) {
    const double u = (double)(i + 1) / (double)(2 * size);
    r_mm[i] = range_mm * u * u;
  }
  dipole_query_init(&query);
  query.evaluator = DIPOLE_F64;
  query.wanted = DIPOLE_R | DIPOLE_CDF;
  query.media = of->media;
  query.layer_count = of->profile.layer_count;
  query.medium_count = CLI_COLOURS;
  query.radii = r_mm;
  query.radius_count = fine;
  if (!CLI_RETRY(of->settings, &error, dipole_eval(of->client, &query, &result, &error))) {
    return cli_fail_error(&error);
  }
  set_rows(&of->sheet, size, 7, names);
  of->sheet.width = size;
  of->sheet.pixels_from = 1;
  for (size_t i = 0; i < size; i++) {
    of->sheet.values[7 * i] = r_mm[2 * i];
  }
  for (size_t c = 0; c < CLI_COLOURS; c++) {
    for (size_t k = 0; k < 2; k++) {
      const double *values = dipole_values_f64(result, (uint32_t)c, quantities[k]);
      for (size_t i = 0; i < size; i++) {
        of->sheet.values[7 * i + 1 + 3 * k + c] = values[2 * i];
      }
      for (size_t i = 1; i < fine; i += 2) {
        const double left = k == 0 ? r_mm[i - 1] / r_mm[i] : 1,
                     right = k == 0 ? r_mm[i + 1] / r_mm[i] : 1;
        const double off = fabs(0.5 * (left * values[i - 1] + right * values[i + 1]) - values[i]);
        errors[k][c] = fmax(errors[k][c], k == 0 ? off / values[i] : off);
      }
      beyond[c] = 1 - values[fine - 1];
    }
  }
  dipole_result_free(result);
  add_fact(&of->sheet, "R_error",
           "largest relative error of r R half the way (of the root of r) between "
           "rows, interpolated",
           errors[0]);
  add_fact(&of->sheet, "cdf_error", "largest error of the cdf there", errors[1]);
  add_fact(&of->sheet, "beyond", "share of the light beyond the last row", beyond);
  return CLI_OK;
}

/* ---- colours --------------------------------------------------------------------------------- */

/* Requests the albedos of single scattering of `count` colours in equal steps from 0 to 1. */
static int ask_albedos(const bake *of, size_t count, double *albedos) {
  const cli_settings *settings = of->settings;
  double *colours = cli_allocate(2 * count, sizeof *colours), *lengths_mm = colours + count;
  const dipole_choice *light = cli_named(of->profile.info, DIPOLE_LIGHT, "light", settings->light);
  dipole_varying_result *result;
  dipole_error error;
  if (light == NULL) {
    return CLI_USAGE;
  }
  for (size_t i = 0; i < count; i++) {
    colours[i] = (double)i / (double)(count - 1);
    lengths_mm[i] = 1;
  }
  const dipole_parameter tolerance = {CORE_PARAMETER_TOLERANCE, 1e-4};
  const dipole_varying_query query = {.model = CORE_MODEL_TRANSPORT,
                                      .evaluator = DIPOLE_F64,
                                      .moments = DIPOLE_EXACT,
                                      .coefficients = DIPOLE_SCATTERED,
                                      .given = DIPOLE_EXTINCTION_PATH,
                                      .light = light->id,
                                      .g = cli_numbers_pick(&settings->g, 0, 0),
                                      .eta = cli_numbers_pick(&settings->eta, 0, 1.5),
                                      .colours = colours,
                                      .lengths_mm = lengths_mm,
                                      .value_count = count,
                                      .parameters = &tolerance,
                                      .parameter_count = 1};
  if (!CLI_RETRY(settings, &error, dipole_varying(of->client, &query, &result, &error))) {
    return cli_fail_error(&error);
  }
  memcpy(albedos, dipole_coefficients_f64(result, DIPOLE_SCATTERED), count * sizeof *albedos);
  dipole_varying_result_free(result);
  return CLI_OK;
}

static int make_colour_map(bake *of) {
  static const char *const names[] = {"scattered"};
  const size_t size = of->settings->size.value, fine = 2 * size - 1;
  double *albedos = cli_allocate(fine, sizeof *albedos), error = CORE_COLOUR_ERROR;
  const int status = ask_albedos(of, fine, albedos);
  if (status != CLI_OK) {
    return status;
  }
  set_rows(&of->sheet, size, 1, names);
  of->sheet.width = size;
  for (size_t i = 0; i < size; i++) {
    /* the colour is darker than that of any medium */
    of->sheet.values[i] = isnan(albedos[2 * i]) ? 0 : albedos[2 * i];
  }
  /* Half-way between two colours, an error of the albedo causes an error of the colour: it is
   * divided by the slope there. */
  for (size_t i = 1; i + 1 < size; i++) {
    const double middle = albedos[2 * i + 1], low = albedos[2 * i], high = albedos[2 * i + 2];
    const double off = fabs(0.5 * (low + high) - middle) / ((high - low) * (double)(size - 1));
    error = fmax(error, off + CORE_COLOUR_ERROR);
  }
  const double g = cli_numbers_pick(&of->settings->g, 0, 0);
  const double eta = cli_numbers_pick(&of->settings->eta, 0, 1.5);
  of->sheet.channels = 1;
  add_fact(&of->sheet, "g", "mean cosine of the scattering angle", &g);
  add_fact(&of->sheet, "eta", "refractive index", &eta);
  add_fact(&of->sheet, "colour_error",
           "largest error of the colour that a walk shows, from the second colour on", &error);
  return CLI_OK;
}

/* ---- the closed form ------------------------------------------------------------------------- */

enum { TERMS = 6, SUMS = 3 };

/* The closed form of core/COLOURS.md for one light. */
typedef struct formula {
  const char *light;
  double error;
  double constants[SUMS][TERMS]; /* of a, b and c */
} formula;

#define ROW(...)                                                                                   \
  { __VA_ARGS__ }
#define FORMULA(LIGHT, error, a, b, c) {#LIGHT, error, {ROW a, ROW b, ROW c}},
static const formula formulas[] = {
#include "clients/cli/formula.def"
};

/* How a language writes a function: what is before its body, around a statement, and at its end. */
static const struct language {
  const char *name, *comment, *head, *number, *end, *last;
} languages[] = {
    {"c", "// ", "#include <math.h>\n\nstatic float scattered(float C, float g, float eta) {\n",
     "  const float ", ";\n", "}\n"},
    {"glsl", "// ", "float scattered(float C, float g, float eta) {\n", "  float ", ";\n", "}\n"},
    {"hlsl", "// ", "float scattered(float C, float g, float eta) {\n", "  float ", ";\n", "}\n"},
    {"osl", "// ", "float scattered(float C, float g, float eta) {\n", "  float ", ";\n", "}\n"},
    {"python", "# ", "def scattered(C, g, eta):\n", "    ", "\n", ""},
};

static int write_formula(const cli_settings *settings) {
  static const char *const terms[TERMS] = {"", " * g", " * g * g", " * e", " * e * g", " * e * e"};
  const char *name = settings->format != NULL ? settings->format : "c";
  const struct language *to = &languages[0];
  const formula *from = NULL;
  for (size_t i = 0; i < sizeof languages / sizeof languages[0]; i++) {
    to = strcmp(languages[i].name, name) == 0 ? &languages[i] : to;
  }
  for (size_t i = 0; i < sizeof formulas / sizeof formulas[0]; i++) {
    from = strcasecmp(formulas[i].light, settings->light) == 0 ? &formulas[i] : from;
  }
  if (from == NULL) {
    return cli_fail_usage("--light: beam or diffuse");
  }
  const bool python = strcmp(name, "python") == 0;
  const char *root = python                   ? "(u * u - 4.0 * q * (1.0 - C)) ** 0.5"
                     : strcmp(name, "c") == 0 ? "sqrtf(u * u - 4.0f * q * (1.0f - C))"
                                              : "sqrt(u * u - 4.0 * q * (1.0 - C))";
  printf("%sThe single-scattering albedo of a half space that shows the linear colour C in %s "
         "light, per\n"
         "%spower that entered, behind a smooth interface of the index eta (1.3 to 1.6), for g 0 "
         "to 0.9.\n"
         "%scolour_error %g (dipoled " DIPOLED_VERSION ", by transport; core/COLOURS.md)\n%s",
         to->comment, settings->light, to->comment, to->comment, from->error, to->head);
  const char *f = strcmp(name, "c") == 0 ? "f" : "";
  printf("%se = eta - 1.45%s%s", to->number, f, to->end);
  for (int k = 0; k < SUMS; k++) {
    printf("%s%c = ", to->number, "abc"[k]);
    for (int i = 0; i < TERMS; i++) {
      const double constant = from->constants[k][i];
      printf("%s%.5f%s%s",
             i == 0         ? constant < 0 ? "-" : ""
             : constant < 0 ? " - "
                            : " + ",
             fabs(constant), f, terms[i]);
    }
    printf("%s", to->end);
  }
  printf("%sq = a - c * C%s%su = 1.0%s + a + b * C%s", to->number, to->end, to->number, f, to->end);
  printf("%ss = 2.0%s * (1.0%s - C) / (u + %s)%s", to->number, f, f, root, to->end);
  printf("%sreturn (1.0%s - s * s) / (1.0%s - g * s * s)%s%s", python ? "    " : "  ", f, f,
         to->end, to->last);
  return CLI_OK;
}

/* ---- writing --------------------------------------------------------------------------------- */

static void put_facts(const sheet *of, FILE *file, const char *before) {
  fprintf(file, "%s%s by transport, dipoled " DIPOLED_VERSION "\n", before, of->kind);
  for (size_t i = 0; i < of->fact_count; i++) {
    const fact *one = &of->facts[i];
    fprintf(file, "%s%s", before, one->name);
    for (size_t c = 0; c < of->channels; c++) {
      fprintf(file, " %.6g", one->values[c]);
    }
    fprintf(file, " (%s)\n", one->about);
  }
}

/* Writes a row, with texts before, between and after its numbers. */
static void put_values(const sheet *of, size_t row, const char *first, const char *between,
                       const char *last) {
  printf("%s", first);
  for (size_t i = 0; i < of->columns; i++) {
    printf("%s%.9g", i > 0 ? between : "", of->values[row * of->columns + i]);
  }
  printf("%s", last);
}

static void put_names(const sheet *of) {
  for (size_t i = 0; i < of->columns; i++) {
    printf("%s%s", i > 0 ? "," : "", of->names[i]);
  }
  printf("\n");
}

static void write_array(const sheet *of, bool shader) {
  const bool vectors = shader && of->columns == 4;
  put_facts(of, stdout, "// ");
  printf("// columns: ");
  put_names(of);
  if (vectors) {
    printf("static const float4 baked[%zu] = {\n", of->rows);
  } else {
    printf("static const float baked[%zu][%zu] = {\n", of->rows, of->columns);
  }
  for (size_t i = 0; i < of->rows; i++) {
    put_values(of, i, vectors ? "  float4(" : "  {", ", ", vectors ? "),\n" : "},\n");
  }
  printf("};\n");
}

static void write_json(const sheet *of) {
  printf("{\"kind\": \"%s\", \"software\": \"dipoled " DIPOLED_VERSION "\",\n", of->kind);
  for (size_t i = 0; i < of->fact_count; i++) {
    printf(" \"%s\": [", of->facts[i].name);
    for (size_t c = 0; c < of->channels; c++) {
      printf("%s%.9g", c > 0 ? ", " : "", of->facts[i].values[c]);
    }
    printf("],\n");
  }
  printf(" \"columns\": [");
  for (size_t i = 0; i < of->columns; i++) {
    printf("%s\"%s\"", i > 0 ? ", " : "", of->names[i]);
  }
  printf("],\n \"rows\": [\n");
  for (size_t i = 0; i < of->rows; i++) {
    put_values(of, i, "  [", ", ", i + 1 < of->rows ? "],\n" : "]\n");
  }
  printf(" ]}\n");
}

/* Writes one-dimensional tables: .spi1d of OpenColorIO, in which comments may only precede the
 * head, or .cube of Adobe. */
static void write_colours(const sheet *of, bool cube) {
  if (cube) {
    put_facts(of, stdout, "# ");
    printf("LUT_1D_SIZE %zu\n", of->rows);
  } else {
    printf("Version 1\nFrom 0 1\nLength %zu\nComponents 1\n{\n", of->rows);
  }
  for (size_t i = 0; i < of->rows; i++) {
    const double v = of->values[i];
    cube ? printf("%.9g %.9g %.9g\n", v, v, v) : printf("%.9g\n", v);
  }
  printf("%s", cube ? "" : "}\n");
  if (!cube) {
    put_facts(of, stdout, "# ");
  }
}

/* Writes a picture whose rows go upward: of lut one for each curvature, of profile R and then the cdf;
 * grey if there is one column. */
static int write_picture(const sheet *of, bool png) {
  const size_t channels = of->columns == 1 ? 1 : 3;
  const size_t count = (of->columns - of->pixels_from) / channels * of->rows;
  const cli_image image = {of->width, count / of->width, channels,
                           cli_allocate(count * channels, sizeof *image.values)};
  for (size_t i = 0; i < count; i++) {
    const double *from =
        of->values + i % of->rows * of->columns + of->pixels_from + channels * (i / of->rows);
    float *to =
        image.values + ((image.height - 1 - i / of->width) * of->width + i % of->width) * channels;
    for (size_t c = 0; c < channels; c++) {
      to[c] = (float)(png ? fmin(fmax(from[c], 0), 1) : from[c]);
    }
  }
  return cli_image_put("standard output", stdout, png, &image) ? CLI_OK : CLI_FAILED;
}

static int write_sheet(const sheet *of, const char *format) {
  const bool png = strcmp(format, "png") == 0;
  if (png || strcmp(format, "pfm") == 0) {
    if (isatty(STDOUT_FILENO) == 1) {
      return cli_fail_usage("--format %s: a terminal cannot show it; write it into a file with >",
                            format);
    }
    put_facts(of, stderr, ""); /* pictures have no room for them */
    return write_picture(of, png);
  }
  if (strcmp(format, "spi1d") == 0 || strcmp(format, "cube") == 0) {
    write_colours(of, format[0] == 'c');
  } else if (strcmp(format, "json") == 0) {
    write_json(of);
  } else if (strcmp(format, "csv") == 0) {
    put_facts(of, stdout, "# ");
    put_names(of);
    for (size_t i = 0; i < of->rows; i++) {
      put_values(of, i, "", ",", "\n");
    }
  } else {
    write_array(of, strcmp(format, "hlsl") == 0);
  }
  return CLI_OK;
}

/* ---- the command ----------------------------------------------------------------------------- */

static const struct kind {
  const char *name;
  int (*make)(bake *of);
  bool of_medium;
  const char *formats, *options; /* options: besides the medium's */
} kinds[] = {
    {"kernel", make_kernel, true, "c,hlsl,csv,json", "taps,range,common"},
    {"burley", make_burley, true, "c,csv,json", ""},
    {"gaussians", make_gaussians, true, "c,csv,json", "count"},
    {"lut", make_lut, true, "c,csv,json,pfm,png", "size"},
    {"profile", make_profile, true, "c,csv,json,pfm", "size,range"},
    {"colour-map", make_colour_map, false, "c,csv,json,spi1d,cube,png", "size,light,g,eta"},
    {"formula", NULL, false, "c,glsl,hlsl,osl,python", "light"},
};

static const struct kind *kind_of(const cli_settings *settings) {
  for (size_t i = 0; settings->operand != NULL && i < sizeof kinds / sizeof kinds[0]; i++) {
    if (strcmp(settings->operand, kinds[i].name) == 0) {
      return &kinds[i];
    }
  }
  return NULL;
}

/* Returns CLI_OK if the kind takes each option that is given. */
static int check_options(const cli_settings *settings, const struct kind *kind) {
  const bool is_stack = settings->layer.count > 0 || settings->thickness.count > 0;
  const struct {
    const char *name;
    bool given, of_medium;
  } taken[] = {
      {"taps", settings->taps.given, false},
      {"range", settings->range.count > 0, false},
      {"common", settings->common, false},
      {"count", settings->count.given, false},
      {"size", settings->size.given, false},
      {"light", strcmp(settings->light, "beam") != 0, false},
      {"g", settings->g.count > 0, true},
      {"eta", settings->eta.count > 0, true},
      {"medium", settings->medium.count > 0 || settings->channel.count > 0, true},
      {"sigma-a, --sigma-s", settings->sigma_a.count > 0 || settings->sigma_s.count > 0, true},
      {"layer, --thickness", is_stack, true},
  };
  for (size_t i = 0; i < sizeof taken / sizeof *taken; i++) {
    if (taken[i].given && !(taken[i].of_medium && kind->of_medium) &&
        !cli_in_list(kind->options, taken[i].name)) {
      return cli_fail_usage("--%s: %s takes no such option: leave it out", taken[i].name,
                            kind->name);
    }
  }
  return !kind->of_medium && (settings->g.count > 1 || settings->eta.count > 1)
             ? cli_fail_usage("--g, --eta: of %s, one number", kind->name)
             : CLI_OK;
}

static bool is_local(const cli_settings *settings) {
  return kind_of(settings)->make == NULL;
}

#define RANGE_MOST_MM 1e6

static int check(cli_settings *settings) {
  const struct kind *kind = kind_of(settings);
  if (kind == NULL) {
    return cli_fail_usage(
        "give a KIND: kernel, burley, gaussians, lut, profile, colour-map or formula");
  }
  if (settings->format != NULL && !cli_in_list(kind->formats, settings->format)) {
    return cli_fail_usage("--format %s: %s has %s", settings->format, kind->name, kind->formats);
  }
  const int status = check_options(settings, kind);
  if (status != CLI_OK) {
    return status;
  }
  const size_t size = settings->size.value, tap_count = settings->taps.value;
  const size_t size_most = kind->make == make_lut ? SPHERE_MAX : SIDE_MAX;
  if (size < SIDE_MIN || size > size_most) {
    return cli_fail_usage("--size: of %s, %d to %zu", kind->name, SIDE_MIN, size_most);
  }
  if (tap_count < TAPS_MIN || tap_count > TAPS_MAX || tap_count % 2 == 0) {
    return cli_fail_usage("--taps: an odd number from %d to %d", TAPS_MIN, TAPS_MAX);
  }
  if (settings->count.value < GAUSSIANS_MIN || settings->count.value > GAUSSIANS_MAX) {
    return cli_fail_usage("--count: %d to %d", GAUSSIANS_MIN, GAUSSIANS_MAX);
  }
  for (size_t i = 0; i < settings->range.count; i++) {
    if (!(settings->range.items[i] > 0 && settings->range.items[i] <= RANGE_MOST_MM)) {
      return cli_fail_usage("--range: more than 0, up to %g mm", RANGE_MOST_MM);
    }
  }
  if (settings->range.count > 1 &&
      (settings->range.count != CLI_COLOURS || kind->make == make_profile)) {
    return cli_fail_usage("--range: one for all channels, or of kernel one for each of three");
  }
  return kind->of_medium ? cli_medium_check(settings) : CLI_OK;
}

/* Sets the radii, and the facts that all kinds of files state about the media. */
static int take_media(bake *of) {
  static const struct {
    const char *name, *about;
  } of_layer[] = {
      /* as the members of dipole_medium */
      {"sigma_a", "absorption coefficient, 1/mm"},  {"sigma_s", "scattering coefficient, 1/mm"},
      {"g", "mean cosine of the scattering angle"}, {"eta", "refractive index"},
      {"thickness", "mm; 0: a half space"},
  };
  double numbers[CLI_COLOURS], colours[CLI_COLOURS], errors[CLI_COLOURS];
  const int status = cli_profile_take(of->settings, of->client, &of->profile);
  if (status != CLI_OK) {
    return status;
  }
  const size_t count = of->profile.channel_count, layers = of->profile.layer_count;
  const bool half_space = layers == 1 && of->profile.media[0].thickness_mm == 0;
  if (count != 1 && count != CLI_COLOURS) {
    return cli_fail_usage("give one channel or three: red, green and blue");
  }
  of->media = cli_allocate(CLI_COLOURS * layers, sizeof *of->media);
  for (size_t i = 0; i < CLI_COLOURS; i++) {
    memcpy(of->media + i * layers, cli_profile_layers(&of->profile, count == 1 ? 0 : i),
           layers * sizeof *of->media);
  }
  if (!cli_edge_radii(of->settings, of->client, of->media, (uint32_t)layers, CLI_COLOURS, &of->r_mm,
                      colours, errors)) {
    return CLI_FAILED;
  }
  for (size_t layer = 0; layer < layers; layer++) {
    for (size_t k = 0; k < (half_space ? 4 : 5); k++) {
      char name[32];
      for (size_t i = 0; i < CLI_COLOURS; i++) {
        numbers[i] = ((const double *)&of->media[i * layers + layer])[k];
      }
      snprintf(name, sizeof name, layers > 1 ? "%s_%zu" : "%s", of_layer[k].name, layer + 1);
      add_fact(&of->sheet, cli_copy(name, strlen(name)), of_layer[k].about, numbers);
    }
  }
  add_fact(&of->sheet, "colour", "share that leaves of the light that entered at normal incidence",
           colours);
  add_fact(&of->sheet, "transport_error",
           "relative error of R and of the cdf; the other errors are beside it", errors);
  return CLI_OK;
}

static int run_bake(const cli_settings *settings, dipole_client *client) {
  const struct kind *kind = kind_of(settings);
  if (kind->make == NULL) {
    return write_formula(settings);
  }
  bake of = {.settings = settings, .client = client};
  of.profile.info = dipole_get_info(client);
  of.sheet.kind = kind->name;
  of.sheet.channels = CLI_COLOURS;
  int status = kind->of_medium ? take_media(&of) : CLI_OK;
  if (status == CLI_OK) {
    status = kind->make(&of);
  }
  return status == CLI_OK
             ? write_sheet(&of.sheet, settings->format != NULL ? settings->format : "c")
             : status;
}

const cli_command cli_command_bake = {
    .name = "bake",
    .operand = "KIND",
    .about = "Bake kernels, lengths and tables of a medium for engines, with their errors",
    .more =
        "KIND is one of:\n"
        "kernel: taps of a separable blur, with the exact light of their bins\n"
        "burley: the length d (mm) of Burley's profile whose shadow edge is the nearest\n"
        "gaussians: shares of the light and variances (mm^2) of Gaussians\n"
        "lut: light that leaves a sphere, over that of a plane at N.L = 1, by N.L, -1 to 1, and "
        "curvature, 0 to 1 per mm, at the middles of texels (pre-integrated, Penner 2011, but over "
        "the whole sphere)\n"
        "profile: R (1/mm^2 per power that entered) and the cdf, the share of the light within r, "
        "by r; pfm has two rows of texels, R and cdf, with r = range u^2 for u from 0 to 1\n"
        "colour-map: the single-scattering albedo of colours 0 to 1, for --g, --eta (default: 1.5) "
        "and --light\n"
        "formula: the same albedo as a function of the colour, g (0 to 0.9) and eta (1.3 to 1.6), "
        "for c, glsl, hlsl, osl and python\n"
        "Values are by transport, linear, and for weights of 1 in each channel: multiply by "
        "`colour`. Each file says its errors. c is an array of C, hlsl one of float4 with "
        "--common.",
    .formats = "c,hlsl,csv,json,pfm,png,spi1d,cube,glsl,osl,python",
    .options = {options, cli_medium_options, cli_layer_options},
    .check = check,
    .is_local = is_local,
    .run = run_bake,
    .examples = "  dipole bake kernel --medium skin1 --eta 1.4\n"
                "  dipole bake kernel --medium skin1 --eta 1.4 --common --format hlsl\n"
                "  dipole bake burley --medium marble --format json\n"
                "  dipole bake profile --medium skin1 --format csv\n"
                "  dipole bake colour-map --eta 1.5 --format spi1d\n"
                "  dipole bake formula --format glsl\n",
};
