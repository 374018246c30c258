#include "core/model_error.h"

#include <math.h>

#include "core/kernels.h"

#define CORE_REAL 64
#include "core/kernel.h"

/* ---- codes ----------------------------------------------------------------------------------- */

#define LEAST 1e-4
#define STEP 1.04
#define COARSE_FROM 230u
#define COARSE_STEP 1.25

/* Returns error * step^count, by repeated squaring. */
static double raised(double error, double step, unsigned count) {
  for (double square = step; count > 0; count >>= 1) {
    error = (count & 1) != 0 ? error * square : error;
    square *= square;
  }
  return error;
}

double core_error_of_code(unsigned code) {
  const unsigned fine = code < COARSE_FROM ? code : COARSE_FROM;
  return code < CORE_ERROR_CODE_ANY ? raised(raised(LEAST, STEP, fine), COARSE_STEP, code - fine)
                                    : (double)INFINITY;
}

unsigned core_error_code(double error) {
  unsigned code = 0;
  while (code < CORE_ERROR_CODE_ANY && !(error <= core_error_of_code(code))) {
    code++;
  }
  return code;
}

/* The symbols are '#' to '~', with two of them replaced: a '?' could begin a trigraph, and a
 * backslash an escape sequence. */
enum { SYMBOL_LEAST = '#', SYMBOL_MOST = '~', SYMBOL_CODE_LEAST = 73, SYMBOL_CODE_STEP = 2 };

unsigned core_error_code_of_symbol(char symbol) {
  const int plain = symbol == ' ' ? '?' : symbol == '!' ? '\\' : symbol;
  return plain < SYMBOL_MOST
             ? (unsigned)(SYMBOL_CODE_LEAST + SYMBOL_CODE_STEP * (plain - SYMBOL_LEAST))
             : CORE_ERROR_CODE_ANY;
}

char core_error_symbol(double error) {
  int plain = SYMBOL_LEAST;
  while (plain < SYMBOL_MOST &&
         !(error <= core_error_of_code(core_error_code_of_symbol((char)plain)))) {
    plain++;
  }
  return plain == '?' ? ' ' : plain == '\\' ? '!' : (char)plain;
}

/* ---- what was measured ----------------------------------------------------------------------- */

const double core_error_edges_mfp[] = {
#define CORE_ERROR_EDGE(mfp) mfp,
#include "core/model_errors.def"
};

static const double ratios[] = {
#define CORE_ERROR_RATIO(ratio) ratio,
#include "core/model_errors.def"
};

static const double etas[] = {
#define CORE_ERROR_ETA(eta) eta,
#include "core/model_errors.def"
};

static const double g_ratios[] = {
#define CORE_ERROR_G_RATIO(ratio) ratio,
#include "core/model_errors.def"
};

/* Edges of the cells. */
static const double cell_gs[] = {
#define CORE_ERROR_CELL_G(g) g,
#include "core/model_errors.def"
};

static const double cell_ratios[] = {
#define CORE_ERROR_CELL_RATIO(ratio) ratio,
#include "core/model_errors.def"
};

static const double cell_etas[] = {
#define CORE_ERROR_CELL_ETA(eta) eta,
#include "core/model_errors.def"
};

enum {
  BANDS = CORE_MODEL_ERROR_BANDS,
  RATIOS = sizeof ratios / sizeof ratios[0],
  ETAS = sizeof etas / sizeof etas[0],
  G_RATIOS = sizeof g_ratios / sizeof g_ratios[0],
  CELL_GS = sizeof cell_gs / sizeof cell_gs[0] - 1,
  CELL_RATIOS = sizeof cell_ratios / sizeof cell_ratios[0] - 1,
  CELL_ETAS = sizeof cell_etas / sizeof cell_etas[0] - 1,
  DIGITS = 2,                  /* number of digits of a code */
  NODE = (BANDS + 1) * DIGITS, /* a code for each band, then the albedo's */
};

_Static_assert(sizeof core_error_edges_mfp / sizeof core_error_edges_mfp[0] == BANDS + 1,
               "as core.h has it");

/* With isotropic scattering. */
static const struct measured {
  unsigned model;
  bool similarity; /* true if g and sigma_s matter only as sigma_s (1 - g) */
  char codes[RATIOS][ETAS * NODE + 1];
} measured[] = {
#define CORE_ERROR_MODEL(model, similarity, ...) {model, similarity, {__VA_ARGS__}},
#include "core/model_errors.def"
};

/* With anisotropic scattering. */
static const struct cells {
  unsigned model;
  char symbols[CELL_GS * CELL_RATIOS][CELL_ETAS * (BANDS + 1) + 1];
} cells[] = {
#define CORE_ERROR_CELLS(model, ...) {model, {__VA_ARGS__}},
#include "core/model_errors.def"
};

enum { MODELS = sizeof measured / sizeof measured[0] };

_Static_assert(MODELS == sizeof cells / sizeof cells[0], "the same models in the same order");

/* For g beyond the cells: those of isotropic scattering in place of anisotropic. */
static const struct similarity {
  double g;
  char codes[G_RATIOS][NODE + 1];
} similarities[] = {
#define CORE_ERROR_SIMILARITY(g, ...) {g, {__VA_ARGS__}},
#include "core/model_errors.def"
};

enum { SIMILARITIES = sizeof similarities / sizeof similarities[0] };

static const double gamma_least[] = {
#define CORE_GAMMA_LEAST(gamma) gamma,
#include "core/gamma_errors.def"
};

static const double gamma_ratios[] = {
#define CORE_GAMMA_RATIO(ratio) ratio,
#include "core/gamma_errors.def"
};

static const double gamma_etas[] = {
#define CORE_GAMMA_ETA(least, most) least, most
#include "core/gamma_errors.def"
};

enum { GAMMA_RATIOS = sizeof gamma_ratios / sizeof gamma_ratios[0] };

static const struct gamma_errors {
  double most;
  char codes[GAMMA_RATIOS][NODE + 1];
} gammas[] = {
#define CORE_GAMMA_ERROR(gamma, ...) {gamma, {__VA_ARGS__}},
#include "core/gamma_errors.def"
};

enum { GAMMAS = sizeof gammas / sizeof gammas[0] };

/* Between nodes the error may be larger than at the nodes around, by up to this factor, and in a
 * cell larger than at the media measured in it. tests/accuracy/test_model_error.c checks both with
 * other media. */
#define BETWEEN_NODES 1.08
#define IN_CELL 1.04

/* ---- where in the map ------------------------------------------------------------------------ */

/* The positions of the two neighbours of a value in a rising list; they are equal if the value is
 * in the list. */
struct span {
  size_t first;
  size_t last;
};

#define SLACK 1e-7 /* relative; rounding to single precision may move a value this far off a node */

/* Finds the neighbours of a value; returns false if it is outside of the list. Each short request
 * looks for its radii, and no branch predictor learns where they lie: comparing with all values of
 * the list is faster than a binary search. */
static inline bool enclose(const double *list, size_t count, double value, struct span *span) {
  if (!(value >= list[0] * (1 - SLACK) && value <= list[count - 1] * (1 + SLACK))) {
    return false;
  }
  size_t low = 0; /* the last one with list[low] <= value */
  for (size_t i = 1; i < count; i++) {
    low += list[i] * (1 - SLACK) <= value;
  }
  span->first = low;
  span->last = list[low] * (1 + SLACK) < value && low + 1 < count ? low + 1 : low;
  return true;
}

/* Sets *span to all places from the first neighbour of the least to the last one of the most. */
static bool enclose_range(const double *list, size_t count, core_ratio_range range,
                          struct span *span) {
  struct span most;
  if (!enclose(list, count, range.least, span) || !enclose(list, count, range.most, &most)) {
    return false;
  }
  span->last = most.last;
  return true;
}

/* Returns the cell between two of `count` + 1 edges that holds the value, or `count` if none
 * does. */
static size_t cell_of(const double *edges, size_t count, double value) {
  if (!(value >= edges[0] - SLACK && value <= edges[count] * (1 + SLACK))) {
    return count;
  }
  size_t cell = 0;
  for (size_t i = 1; i < count; i++) {
    cell += edges[i] <= value;
  }
  return cell;
}

static unsigned digit(char hexadecimal) {
  return (unsigned)(hexadecimal <= '9' ? hexadecimal - '0' : hexadecimal - 'a' + 10);
}

/* Raises each code to that of a node if the node's is larger. */
static void merge_node(unsigned char codes[BANDS + 1], const char *node) {
  for (size_t i = 0; i <= BANDS; i++) {
    const unsigned code = 16 * digit(node[DIGITS * i]) + digit(node[DIGITS * i + 1]);
    codes[i] = code > codes[i] ? (unsigned char)code : codes[i];
  }
}

/* ---- the errors of a medium ------------------------------------------------------------------ */

static bool find_isotropic(unsigned char codes[BANDS + 1], const struct measured *of, double eta,
                           core_ratio_range range) {
  struct span at_ratio, at_eta;
  if (!enclose_range(ratios, RATIOS, range, &at_ratio) || !enclose(etas, ETAS, eta, &at_eta)) {
    return false;
  }
  for (size_t i = at_ratio.first; i <= at_ratio.last; i++) {
    for (size_t j = at_eta.first; j <= at_eta.last; j++) {
      merge_node(codes, &of->codes[i][j * NODE]);
    }
  }
  return true;
}

static bool find_anisotropic(unsigned char codes[BANDS + 1], const struct cells *of, double g,
                             double eta, core_ratio_range range) {
  const size_t plane = cell_of(cell_gs, CELL_GS, g);
  const size_t first = cell_of(cell_ratios, CELL_RATIOS, range.least);
  const size_t last = cell_of(cell_ratios, CELL_RATIOS, range.most);
  const size_t column = cell_of(cell_etas, CELL_ETAS, eta);
  if (plane == CELL_GS || first == CELL_RATIOS || last == CELL_RATIOS || column == CELL_ETAS) {
    return false;
  }
  for (size_t row = first; row <= last; row++) {
    const char *symbols = &of->symbols[plane * CELL_RATIOS + row][column * (BANDS + 1)];
    for (size_t i = 0; i <= BANDS; i++) {
      const unsigned code = core_error_code_of_symbol(symbols[i]);
      codes[i] = code > codes[i] ? (unsigned char)code : codes[i];
    }
  }
  return true;
}

/* The g between the first and the last of the list get the largest error of the list. */
static bool find_similarity(unsigned char codes[BANDS + 1], double g, double eta,
                            core_ratio_range range) {
  struct span at_ratio, at_eta;
  if (!(g >= similarities[0].g && g <= similarities[SIMILARITIES - 1].g) ||
      !enclose_range(g_ratios, G_RATIOS, range, &at_ratio) || !enclose(etas, ETAS, eta, &at_eta)) {
    return false;
  }
  for (size_t k = 0; k < SIMILARITIES; k++) {
    for (size_t i = at_ratio.first; i <= at_ratio.last; i++) {
      merge_node(codes, similarities[k].codes[i]);
    }
  }
  return true;
}

static double error_of(unsigned code, double margin) {
  return code < CORE_ERROR_CODE_ANY ? core_error_of_code(code) * margin : (double)NAN;
}

/* Returns the position of a model in both lists, or MODELS if it was not measured. */
static size_t find_model(enum core_model model) {
  size_t i = 0;
  while (i < MODELS && measured[i].model != (unsigned)model) {
    i++;
  }
  return i;
}

core_model_errors core_model_errors_exact(void) {
  return (core_model_errors){.exact = true};
}

core_model_errors core_model_errors_unknown(void) {
  core_model_errors errors = {.exact = false};
  for (size_t i = 0; i <= BANDS; i++) {
    errors.error[i] = (double)NAN;
  }
  return errors;
}

/* Finds the errors of a model that sees isotropic scattering of sigma_s (1 - g), for g beyond the
 * cells. of: NULL for `transport`, which has no other error. */
static bool find_beyond(core_model_errors *errors, const struct measured *of, double g, double eta,
                        core_ratio_range range) {
  unsigned char codes[BANDS + 1] = {0}, similarity[BANDS + 1] = {0};
  if (!find_similarity(similarity, g, eta, range) ||
      (of != NULL && !(of->similarity && find_isotropic(codes, of, eta, range)))) {
    return false;
  }
  for (size_t i = 0; i <= BANDS; i++) {
    const double isotropic = of != NULL ? error_of(codes[i], BETWEEN_NODES) : 0;
    errors->error[i] = (1 + isotropic) * (1 + error_of(similarity[i], BETWEEN_NODES)) - 1;
  }
  return true;
}

core_ratio_range core_ratio_of(const core_medium *medium) {
  const double ratio = medium->sigma_a_per_mm / (medium->sigma_s_per_mm * (1 - medium->g));
  return (core_ratio_range){ratio, ratio};
}

core_model_errors core_model_errors_find(enum core_model model, enum core_moments moments, double g,
                                         double eta, core_ratio_range range) {
  const bool isotropic = !(g < 0 || g > 0);
  const size_t at = find_model(model);
  const bool is_measured = at < MODELS && moments == CORE_MOMENTS_EXACT;
  unsigned char codes[BANDS + 1] = {0};
  core_model_errors errors = core_model_errors_unknown();
  if (model == CORE_MODEL_TRANSPORT && isotropic) {
    return core_model_errors_exact();
  }
  if (is_measured && (isotropic ? find_isotropic(codes, &measured[at], eta, range)
                                : find_anisotropic(codes, &cells[at], g, eta, range))) {
    for (size_t i = 0; i <= BANDS; i++) {
      errors.error[i] = error_of(codes[i], isotropic ? BETWEEN_NODES : IN_CELL);
    }
  } else if (is_measured || model == CORE_MODEL_TRANSPORT) {
    find_beyond(&errors, is_measured ? &measured[at] : NULL, g, eta, range);
  }
  return errors;
}

core_model_errors core_gamma_errors_find(double gamma, double eta, core_ratio_range range) {
  core_model_errors errors = core_model_errors_unknown();
  unsigned char codes[BANDS + 1] = {0};
  struct span at_ratio, at_eta;
  size_t at = 0;
  while (at < GAMMAS && gamma > gammas[at].most * (1 + SLACK)) {
    at++;
  }
  if (!(gamma >= gamma_least[0] * (1 - SLACK)) || at == GAMMAS ||
      !enclose_range(gamma_ratios, GAMMA_RATIOS, range, &at_ratio) ||
      !enclose(gamma_etas, sizeof gamma_etas / sizeof gamma_etas[0], eta, &at_eta)) {
    return errors;
  }
  for (size_t i = at_ratio.first; i <= at_ratio.last; i++) {
    merge_node(codes, gammas[at].codes[i]);
  }
  for (size_t i = 0; i <= BANDS; i++) {
    errors.error[i] = error_of(codes[i], BETWEEN_NODES);
  }
  return errors;
}

core_model_errors core_model_errors_stated(enum core_model model, enum core_moments moments,
                                           unsigned notes, const core_parameters *parameters,
                                           double g, double eta, core_ratio_range range) {
  const bool exact = model == CORE_MODEL_TRANSPORT && (notes & CORE_NOTE_SIMILARITY) == 0;
  const double gamma = parameters->value[CORE_PARAMETER_GAMMA];
  if (!isnan(gamma)) {
    return exact ? core_gamma_errors_find(gamma, eta, range) : core_model_errors_unknown();
  }
  return exact ? core_model_errors_exact()
         : isnan(parameters->value[CORE_PARAMETER_SURFACE_ALBEDO])
             ? core_model_errors_find(model, moments, g, eta, range)
             : core_model_errors_unknown();
}

/* ---- the error of what is wanted ------------------------------------------------------------- */

enum {
  LIKE_R = CORE_QUANTITY_R | CORE_QUANTITY_RING | CORE_QUANTITY_S,
  MEASURED_AT_RADII = LIKE_R | CORE_QUANTITY_LN_R | CORE_QUANTITY_PDF,
};

/* Returns the largest error of R at these radii, or NAN if it is not known. */
static double error_of_R(const core_model_errors *errors, const core_medium *medium,
                         core_radii_range radii) {
  const double sigma_t_prime = medium->sigma_a_per_mm + medium->sigma_s_per_mm * (1 - medium->g);
  struct span least, most;
  if (!enclose(core_error_edges_mfp, BANDS + 1, radii.least_mm * sigma_t_prime, &least) ||
      !enclose(core_error_edges_mfp, BANDS + 1, radii.most_mm * sigma_t_prime, &most)) {
    return (double)NAN;
  }
  const size_t first = least.first < BANDS ? least.first : BANDS - 1;
  double error = 0;
  for (size_t band = first; band == first || band < most.last; band++) {
    const double here = errors->error[band];
    error = here <= error ? error : here; /* `here` may be NAN */
    if (isnan(here)) {
      return here;
    }
  }
  return error;
}

/* Returns the larger number, or NAN if either is NAN. */
static double larger(double a, double b) {
  return isnan(a) || a > b ? a : b;
}

double core_model_errors_of(const core_model_errors *errors, const core_medium *medium,
                            unsigned wanted, core_radii_range radii) {
  if (errors->exact) {
    return 0;
  }
  const double albedo = errors->error[BANDS];
  if (!(radii.least_mm <= radii.most_mm)) {
    wanted &= CORE_QUANTITY_ALBEDO;
  }
  const bool at_radii = (wanted & MEASURED_AT_RADII) != 0;
  const double R = at_radii ? error_of_R(errors, medium, radii) : 0;
  double error = at_radii || (wanted & CORE_QUANTITY_ALBEDO) != 0 ? 0 : (double)NAN;
  if ((wanted & LIKE_R) != 0) {
    error = larger(error, R);
  }
  if ((wanted & CORE_QUANTITY_ALBEDO) != 0) {
    error = larger(error, albedo);
  }
  if ((wanted & CORE_QUANTITY_LN_R) != 0) { /* ln R changes by < R / (1 - R) */
    error = larger(error, R < 1 ? R / (1 - R) : (double)NAN);
  }
  if ((wanted & CORE_QUANTITY_PDF) != 0) { /* (1 + R) / (1 - albedo) - 1 */
    error = larger(error, albedo < 1 ? (R + albedo) / (1 - albedo) : (double)NAN);
  }
  return error;
}

double core_error_beyond(core_reach reach, double most_mm) {
  if (!(most_mm > reach.most_mm)) {
    return 0;
  }
  const double logarithm = real_log(fmin(most_mm / reach.most_mm, 1e300), 0);
  const double exponent = reach.growth * logarithm * logarithm;
  return exponent < 7 ? real_exp_signed(exponent) - 1 : (double)INFINITY;
}

/* Returns how many edges between two bands lie below a radius in mean free paths. */
static size_t edges_below(double mfp) {
  size_t count = 0;
  for (size_t i = 1; i < BANDS; i++) {
    count += core_error_edges_mfp[i] < mfp;
  }
  return count;
}

double core_banded_error(const double errors[CORE_MODEL_ERROR_BANDS + 1], double all,
                         const core_medium *medium, unsigned wanted, core_radii_range radii) {
  enum {
    ANY = CORE_QUANTITY_CDF | CORE_QUANTITY_SLOPE | CORE_QUANTITY_PDF | CORE_QUANTITY_TRANSFER
  };
  const double sigma_t_prime = core_sigma_t_prime(medium);
  const bool at_radii = radii.least_mm <= radii.most_mm;
  if (at_radii && (wanted & ANY) != 0) {
    return all;
  }
  const bool of_R = at_radii && (wanted & (LIKE_R | CORE_QUANTITY_LN_R)) != 0;
  double error = of_R && (wanted & CORE_QUANTITY_ALBEDO) == 0 ? 0 : errors[BANDS];
  const size_t first = edges_below(radii.least_mm * sigma_t_prime * (1 + SLACK));
  const size_t last = edges_below(radii.most_mm * sigma_t_prime * (1 - SLACK));
  for (size_t band = first; of_R && (band == first || band <= last); band++) {
    error = fmax(error, errors[band]);
  }
  return error;
}

/* The quantities whose numerical error grows beyond the reach. The cdf and albedo are not among
 * them, because almost no energy is left there. */
enum { FOLLOWS_R = MEASURED_AT_RADII | CORE_QUANTITY_SLOPE };

/* The reach of neighbours, over that of the profile. */
#define NEAR_REACH 0.9

/* Returns the error of the derivatives of ln R, absolute. Beyond the reach it is not known. */
static double derivative_error(const core_profile *profile, core_radii_range radii) {
  const bool known =
      radii.least_mm > radii.most_mm || radii.most_mm <= NEAR_REACH * profile->reach.most_mm;
  return known ? profile->derivative_error : (double)INFINITY;
}

/* Returns whether values next to the source may have underflowed on the way. */
static bool is_too_near(const core_profile *profile, unsigned wanted, double r_mm) {
  const double least_mm = CORE_RADIUS_SMALL_MFP / core_sigma_t_prime(&profile->medium);
  return r_mm > 0 &&
         (((wanted & (FOLLOWS_R | CORE_QUANTITY_CDF)) != 0 && r_mm < CORE_RADIUS_SMALL_MM) ||
          ((wanted & CORE_QUANTITY_SLOPE) != 0 && r_mm < least_mm));
}

core_stated_errors core_profile_errors(const core_profile *profile, unsigned wanted,
                                       core_radii_range radii) {
  const bool derivatives = core_wants_derivatives(wanted);
  const bool others =
      (wanted & ~(unsigned)(CORE_QUANTITY_BY_SIGMA_A | CORE_QUANTITY_BY_SIGMA_S)) != 0;
  const double most_mm = (wanted & FOLLOWS_R) != 0 ? radii.most_mm : 0;
  const double numerical = core_banded_error(profile->numerical_errors, profile->numerical_error,
                                             &profile->medium, wanted, radii);
  const double slope = (wanted & CORE_QUANTITY_SLOPE) != 0 ? profile->slope_error : 0;
  const double of_others = fmax(numerical, slope) + core_error_beyond(profile->reach, most_mm) +
                           ((wanted & CORE_QUANTITY_S) != 0 ? CORE_S_ERROR : 0) +
                           ((wanted & CORE_QUANTITY_TRANSFER) != 0 ? CORE_TRANSFER_ERROR : 0);
  if (is_too_near(profile, wanted, radii.least_mm)) {
    return (core_stated_errors){.numerical = (double)INFINITY, .model = (double)NAN};
  }
  return (core_stated_errors){
      .numerical = fmax(others ? of_others : 0, derivatives ? derivative_error(profile, radii) : 0),
      .numerical_per_mm = fmax(others ? profile->numerical_error_per_mm : 0,
                               derivatives ? profile->derivative_error_per_mm : 0),
      .model = core_model_errors_of(&profile->model_errors, &profile->medium, wanted, radii),
  };
}
