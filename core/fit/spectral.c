#include "core/fit/spectral.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>

#include "core/fit/search.h"
#include "core/kernels.h"

#define CORE_REAL 64
#include "core/kernel.h"

enum { MOST = CORE_SPECTRAL_UNKNOWNS_MAX, CANDIDATES = 15, STARTS = 5, STEPS_MAX = 100 };

/* Amounts, a and b, sought or given. */
enum { TERMS_MAX = CORE_PROPERTIES_END };

/* An unknown without a value that is given starts at this share of the range between its limits. */
#define START_SHARE 0.02
#define A_LEAST_PER_MM 1e-6

/* A descent is settled after a step of fewer standard errors, and with logarithms, which only come
 * near, after one that lowers chi-squared by less than a reading's share. */
#define STEP_END 1e-6
#define FALL_NEAR 1e-2
/* If rounding keeps chi-squared from falling, a step that was to lower it by this share is the last. */
#define FALL_ROUNDED 1e-9
#define DAMPING_FIRST 1e-2
#define DAMPING_LEAST 1e-12
#define DAMPING_MOST 1e10
/* Eigenvalues of a matrix with a diagonal of 1 below this are rounding. Errors are infinite if they
 * are so many times what they would be with all other unknowns known. */
#define ROUNDING 1e-15
#define ERROR_MOST 1e6
/* A second minimum differs by so many standard errors: a quadratic chi-squared has none. */
#define APART 1.0
/* The errors are too small if chi-squared, with a or else b so many of them away, is that of a second
 * solution: a quadratic chi-squared is larger by the square. They are not if it is about that. */
#define PROBE 4.0
#define PROBE_NEAR 0.25

#define DEGREES 57.29577951308232

/* Chi-squared around x as far as it is quadratic, with the factor eliminated. */
struct quadratic {
  double x[MOST];
  bool logarithms; /* whether the residuals are logarithmic; the factor is then its logarithm */
  bool outside;    /* whether a wavelength's medium is beyond those that are tried */
  double factor, chi_squared;
  double information[MOST][MOST];
  double to[MOST];           /* minus half the derivatives of chi-squared */
  double along_factor[MOST]; /* projection of each derivative on that by ln factor */
  double of_factor;          /* information of ln factor alone; 0 if the factor is known */
};

/* The information with a diagonal of 1: vectors[.][j] has the eigenvalue values[j]. */
struct spectrum {
  double scale[MOST]; /* of the unknowns; 0 where the information is */
  double vectors[MOST][MOST], values[MOST];
};

enum stage { COMPARES, BEGINS, COMES_NEAR, SETTLES, ENDS };

struct minimum {
  double x[MOST], chi_squared;
  bool settled, probed; /* probed: of a part of the range alone */
};

/* A number of the medium: sought between low and high, from `start` on, if high is above low; else
 * `start` is given. */
struct term {
  unsigned property;
  double start, low, high;
};

struct core_spectral {
  const core_fit *fit;
  size_t wavelengths, places, count; /* count: of readings */
  size_t chromophores, unknowns, oxy, deoxy;
  double rayleigh_share, vessel_radius_mm;
  struct term terms[TERMS_MAX]; /* amounts, ln a and b */
  size_t term_of[MOST];
  double low[MOST], high[MOST];  /* of the unknowns x: amounts, ln a and b */
  const double *values, *errors; /* the set */
  enum stage stage;
  unsigned evaluations;
  int candidate, left;
  size_t next, minimum_count;
  unsigned probes;      /* that have begun */
  double *probe, usual; /* the limit that a probe has moved, NULL without one, and what it was */
  struct minimum starts[STARTS], minima[STARTS + 2];
  struct quadratic now;
  double damping;
  /* [wavelengths]: ln(wavelength / 500 nm); sigma_a and the derivative of ln sigma_s' by b as they were
   * evaluated last */
  double *ln_wavelength, *sigma_a, *by_b;
  struct fit_place *media;
  /* [wavelengths][chromophores]: absorption, and derivatives of sigma_a by the amounts */
  double *absorption, *by_amount;
  /* [count]: the model's values, and derivatives by ln_ratio and by ln_scattering; logarithms of the
   * readings and of the model, or numerical errors */
  double *model, *by_ratio, *by_scattering, *ln_values, *ln_model;
};

/* ---- what is sought -------------------------------------------------------------------------- */

static bool is_sought(const struct term *term) {
  return term->high > term->low;
}

/* Returns the start and the limits of what is sought. */
static struct term term_of(const core_tissue *tissue, const core_sought *sought, double most) {
  const unsigned id = sought->property;
  const bool is_a = id == CORE_PROPERTY_A, is_b = id == CORE_PROPERTY_B;
  struct term term = {id, tissue->value[id], sought->low, sought->high};
  if (sought->low == 0 && sought->high == 0) {
    term.low = is_a ? 0.2 : is_b ? -0.5 : 0;
    term.high = is_a ? 10 : is_b ? 4 : id <= CORE_PROPERTY_HB ? CORE_BLOOD_UM : most;
  }
  if (!(term.start > term.low && term.start < term.high)) {
    term.start = is_a   ? sqrt(term.low * term.high)
                 : is_b ? 0.5 * (term.low + term.high)
                        : fma(START_SHARE, term.high - term.low, term.low);
  }
  return term;
}

/* Sets by_id[] of what is sought, and where its search starts in the tissue. */
static core_fault take_sought(const core_spectral_design *design, core_tissue *tissue,
                              struct term by_id[CORE_PROPERTIES_END]) {
#define LEAST_OF(P, id, IDENT, name, about, least, most, usual) [id] = (least),
#define MOST_OF(P, id, IDENT, name, about, least, most, usual) [id] = (most),
  static const double leasts[CORE_PROPERTIES_END] = {CORE_EACH_PROPERTY(LEAST_OF, )};
  static const double mosts[CORE_PROPERTIES_END] = {CORE_EACH_PROPERTY(MOST_OF, )};
  for (size_t i = 0; i < design->sought_count; i++) {
    const unsigned id = design->sought[i].property;
    if (core_choice_by_id(core_properties, id) == NULL ||
        (id > CORE_CHROMOPHORES_MAX && id != CORE_PROPERTY_A && id != CORE_PROPERTY_B)) {
      return (core_fault){"property", "an amount, a_per_mm or b", i};
    }
    if (is_sought(&by_id[id])) {
      return (core_fault){"property", "each one once", i};
    }
    struct term *term = &by_id[id];
    *term = term_of(tissue, &design->sought[i], mosts[id]);
    if (!(is_sought(term) && term->high <= mosts[id])) {
      return (core_fault){"high", "above low, and within the range of the property", i};
    }
    if (!(term->low >= (id == CORE_PROPERTY_A ? A_LEAST_PER_MM : leasts[id]))) {
      return (core_fault){"low", "within the range of the property, of a_per_mm from 1e-6", i};
    }
    tissue->value[id] = term->start;
  }
  return core_tissue_check(tissue);
}

/* Lists the terms: amounts that are sought or not 0, a and b. */
static void list_terms(core_spectral *of, const core_tissue *tissue, const struct term *by_id) {
  size_t count = 0;
  for (const core_choice *one = core_properties; one->id <= CORE_PROPERTY_B && one->name != NULL;
       one++) {
    const bool sought = is_sought(&by_id[one->id]);
    const double value = tissue->value[one->id];
    struct term term = sought ? by_id[one->id] : (struct term){one->id, value, 0, 0};
    if (!sought && !(value > 0) && one->id <= CORE_CHROMOPHORES_MAX) {
      continue;
    }
    if (one->id == CORE_PROPERTY_A) {
      of->chromophores = count;
      term = (struct term){one->id, fit_ln(term.start), fit_ln(term.low), fit_ln(term.high)};
    }
    if (sought) {
      of->low[of->unknowns] = term.low;
      of->high[of->unknowns] = term.high;
      of->term_of[of->unknowns++] = count;
    }
    of->terms[count++] = term;
  }
  of->oxy = of->deoxy = of->chromophores;
  for (size_t i = 0; i < of->chromophores; i++) {
    of->oxy = of->terms[i].property == CORE_PROPERTY_HBO2 ? i : of->oxy;
    of->deoxy = of->terms[i].property == CORE_PROPERTY_HB ? i : of->deoxy;
  }
}

/* ---- preparing ------------------------------------------------------------------------------- */

/* Makes room for the arrays. */
static bool allocate(core_spectral *of) {
  const size_t wavelengths = of->wavelengths, count = of->count,
               all = of->chromophores * wavelengths;
  double *numbers = malloc((5 * wavelengths + 2 * all + 5 * count) * sizeof *numbers);
  if (numbers == NULL) {
    return false;
  }
  of->ln_wavelength = numbers;
  of->sigma_a = numbers + wavelengths;
  of->media = (struct fit_place *)(void *)(numbers + 2 * wavelengths);
  of->by_b = numbers + 4 * wavelengths;
  of->absorption = numbers + 5 * wavelengths;
  of->by_amount = of->absorption + all;
  of->model = of->by_amount + all;
  of->by_ratio = of->model + count;
  of->by_scattering = of->by_ratio + count;
  of->ln_values = of->by_scattering + count;
  of->ln_model = of->ln_values + count;
  return true;
}

/* Sets logarithms of the wavelengths and the absorption there. */
static core_fault set_spectra(core_spectral *of, const core_tissue *tissue,
                              const double *wavelength_nm) {
  core_fault fault = {0};
  for (size_t l = 0; l < of->wavelengths && fault.field == NULL; l++) {
    core_medium medium;
    fault = core_tissue_medium(tissue, wavelength_nm[l], &medium);
    for (size_t i = 0; i < of->chromophores && fault.field == NULL; i++) {
      fault = core_chromophore_at((enum core_property)of->terms[i].property, tissue->haemoglobin,
                                  wavelength_nm[l], &of->absorption[l * of->chromophores + i]);
    }
    of->ln_wavelength[l] = fit_ln(wavelength_nm[l] / 500);
    fault.index = l;
  }
  return fault;
}

core_fault core_spectral_create(core_spectral **made, const core_spectral_design *design,
                                size_t places, unsigned scale) {
  const size_t wavelengths = design->wavelength_count, count = wavelengths * places;
  struct term by_id[CORE_PROPERTIES_END] = {{0}};
  core_tissue tissue = design->tissue;
  assert(design->sought_count >= 1);
  *made = NULL;
  core_fault fault = take_sought(design, &tissue, by_id);
  if (fault.field != NULL) {
    return fault;
  }
  if (!(tissue.value[CORE_PROPERTY_A] >= A_LEAST_PER_MM)) {
    return (core_fault){"a_per_mm", "from 1e-6", 0};
  }
  if (!(wavelengths >= 1 && count >= design->sought_count + (scale == CORE_FIT_SCALE_FREE) &&
        count <= CORE_SPECTRAL_READINGS_MAX)) {
    return (core_fault){"wavelength_count",
                        "such that a set has as many readings as unknowns, to 4096", 0};
  }
  core_spectral *of = calloc(1, sizeof *of);
  if (of == NULL) {
    return CORE_OUT_OF_MEMORY;
  }
  of->wavelengths = wavelengths;
  of->places = places;
  of->count = count;
  of->rayleigh_share = tissue.value[CORE_PROPERTY_RAYLEIGH];
  of->vessel_radius_mm = tissue.value[CORE_PROPERTY_VESSEL_RADIUS];
  list_terms(of, &tissue, by_id);
  fault = allocate(of) ? set_spectra(of, &tissue, design->wavelength_nm) : CORE_OUT_OF_MEMORY;
  if (fault.field != NULL) {
    core_spectral_free(of);
  } else {
    *made = of;
  }
  return fault;
}

void core_spectral_free(core_spectral *spectral) {
  if (spectral != NULL) {
    free(spectral->ln_wavelength); /* and all arrays behind it */
    free(spectral);
  }
}

/* ---- chi-squared ----------------------------------------------------------------------------- */

static double clamp(double x, double least, double most) {
  return real_min(real_max(x, least), most);
}

/* Returns term i of x: an amount, ln a or b. */
static double term_at(const core_spectral *of, const double *x, size_t i) {
  for (size_t k = 0; k < of->unknowns; k++) {
    if (of->term_of[k] == i) {
      return x[k];
    }
  }
  return of->terms[i].start;
}

/* Returns the derivative of the absorption of blood in vessels by the amount `own` of one haemoglobin,
 * which absorbs per_mm; the other's follow. It is C m + e^-x other (per_mm - other_per_mm) / total,
 * with m the mean of both and x = 2 r m of whole blood. */
static double by_haemoglobin(double radius_mm, double own, double per_mm, double other,
                             double other_per_mm) {
  const double total = own + other;
  const double share = total > 0 ? other / total : 0;
  const double change = share * (per_mm - other_per_mm), mean = per_mm - change;
  const double x = 2 * radius_mm * CORE_BLOOD_UM * mean, packaging = core_packaging_of(x);
  return packaging * mean + (1 - x * packaging) * change;
}

/* Sets the derivatives of sigma_a by the amounts, whose products with the amounts add up to it. */
static void set_absorption(const core_spectral *of, size_t l, const double *amounts) {
  const size_t n = of->chromophores, oxy = of->oxy, deoxy = of->deoxy;
  const double *own = of->absorption + l * n, radius_mm = of->vessel_radius_mm;
  double *by = of->by_amount + l * n;
  memcpy(by, own, n * sizeof *by);
  const double hbo2 = oxy < n ? amounts[oxy] : 0, hbo2_per_mm = oxy < n ? own[oxy] : 0;
  const double hb = deoxy < n ? amounts[deoxy] : 0, hb_per_mm = deoxy < n ? own[deoxy] : 0;
  if (radius_mm > 0 && oxy < n) {
    by[oxy] = by_haemoglobin(radius_mm, hbo2, hbo2_per_mm, hb, hb_per_mm);
  }
  if (radius_mm > 0 && deoxy < n) {
    by[deoxy] = by_haemoglobin(radius_mm, hb, hb_per_mm, hbo2, hbo2_per_mm);
  }
}

/* Returns ln sigma_s', and sets its derivative by b. */
static double ln_scattering_of(const core_spectral *of, size_t l, double ln_a, double b) {
  const double ln = of->ln_wavelength[l], share = of->rayleigh_share;
  if (share > 0) {
    const double mie = (1 - share) * real_exp_signed(-b * ln);
    const double both = share * real_exp_signed(-4 * ln) + mie;
    of->by_b[l] = -ln * mie / both;
    return ln_a + fit_ln(both);
  }
  of->by_b[l] = -ln;
  return fma(-b, ln, ln_a);
}

/* Sets the media of x. Returns whether one is beyond those that are tried. */
static bool set_media(core_spectral *of, const double *x) {
  const struct fit_place *least = &of->fit->least, *most = &of->fit->most;
  const double ln_a = term_at(of, x, of->chromophores), b = term_at(of, x, of->chromophores + 1);
  double amounts[TERMS_MAX];
  bool outside = false;
  for (size_t i = 0; i < of->chromophores; i++) {
    amounts[i] = term_at(of, x, i);
  }
  for (size_t l = 0; l < of->wavelengths; l++) {
    double sigma_a = 0;
    set_absorption(of, l, amounts);
    for (size_t i = 0; i < of->chromophores; i++) {
      sigma_a = fma(amounts[i], of->by_amount[l * of->chromophores + i], sigma_a);
    }
    const double ln_scattering = ln_scattering_of(of, l, ln_a, b);
    const double ln_ratio = fit_ln(sigma_a) - ln_scattering;
    const struct fit_place place = {
        clamp(ln_ratio, least->ln_ratio, most->ln_ratio),
        clamp(ln_scattering, least->ln_scattering, most->ln_scattering)};
    outside |= place.ln_ratio < ln_ratio || place.ln_ratio > ln_ratio ||
               place.ln_scattering < ln_scattering || place.ln_scattering > ln_scattering;
    of->media[l] = place;
    of->sigma_a[l] = real_exp_signed(place.ln_ratio + place.ln_scattering);
  }
  return outside;
}

/* What unknown k adds to ln_ratio and to ln_scattering at a wavelength. */
struct chain {
  double ratio, scattering;
};

static struct chain chain_of(const core_spectral *of, size_t l, size_t k) {
  const size_t i = of->term_of[k];
  return i < of->chromophores
             ? (struct chain){of->by_amount[l * of->chromophores + i] / of->sigma_a[l], 0}
         : i == of->chromophores ? (struct chain){-1, 1}
                                 : (struct chain){-of->by_b[l], of->by_b[l]};
}

/* A residual, and the derivatives of what it is a difference to, by ln_ratio, ln_scattering and
 * ln factor. */
struct residual {
  double off, r, s, f;
};

static struct residual residual_of(const core_spectral *of, const struct quadratic *q, size_t i) {
  if (fit_quantity_of(&of->fit->places, i % of->places) != 0) {
    const double weight = 1 / of->errors[i];
    return (struct residual){weight * (of->values[i] - of->model[i]), weight * of->by_ratio[i],
                             weight * of->by_scattering[i], 0};
  }
  if (q->logarithms) {
    const double weight = real_max(of->values[i], 0) / of->errors[i];
    const double slope = weight / real_max(of->model[i], 0x1p-1022);
    return (struct residual){weight * (of->ln_values[i] - of->ln_model[i] - q->factor),
                             slope * of->by_ratio[i], slope * of->by_scattering[i], weight};
  }
  const double weight = 1 / of->errors[i], scaled = q->factor * weight;
  return (struct residual){weight * of->values[i] - scaled * of->model[i], scaled * of->by_ratio[i],
                           scaled * of->by_scattering[i], scaled * of->model[i]};
}

/* Returns the factor that fits best, or its logarithm. */
static double best_factor(const core_spectral *of, bool logarithms) {
  struct quadratic one = {.logarithms = logarithms, .factor = logarithms ? 0 : 1};
  double both = 0, square = 0;
  for (size_t i = 0; of->fit->free_factor && i < of->count; i++) {
    const struct residual at = residual_of(of, &one, i);
    both += at.f * (at.off + (logarithms ? 0 : at.f));
    square += at.f * at.f;
  }
  return !of->fit->free_factor ? one.factor : square > 0 ? both / square : 0;
}

/* Adds the residuals of a wavelength. */
static void add_wavelength(const core_spectral *of, size_t l, struct quadratic *q) {
  double rr = 0, rs = 0, ss = 0, ro = 0, so = 0, rf = 0, sf = 0;
  for (size_t i = l * of->places; i < (l + 1) * of->places; i++) {
    const struct residual at = residual_of(of, q, i);
    q->chi_squared += at.off * at.off;
    q->of_factor += at.f * at.f;
    rr += at.r * at.r;
    rs += at.r * at.s;
    ss += at.s * at.s;
    ro += at.r * at.off;
    so += at.s * at.off;
    rf += at.r * at.f;
    sf += at.s * at.f;
  }
  for (size_t k = 0; k < of->unknowns; k++) {
    const struct chain by = chain_of(of, l, k);
    q->to[k] += by.ratio * ro + by.scattering * so;
    q->along_factor[k] += by.ratio * rf + by.scattering * sf;
    for (size_t j = 0; j <= k; j++) {
      const struct chain and = chain_of(of, l, j);
      q->information[k][j] += by.ratio * (and.ratio * rr + and.scattering * rs) +
                              by.scattering * (and.ratio * rs + and.scattering * ss);
    }
  }
}

/* Evaluates the model around x. Returns false if there is no finite chi-squared. */
static bool expand(core_spectral *of, const double *x, bool logarithms, struct quadratic *q) {
  const size_t n = of->unknowns, places = of->places;
  *q = (struct quadratic){.logarithms = logarithms, .outside = set_media(of, x)};
  memcpy(q->x, x, sizeof q->x);
  of->evaluations++;
  for (size_t l = 0; l < of->wavelengths; l++) {
    if (fit_values(&of->fit->model, of->media[l], &of->fit->places, of->model + l * places,
                   of->by_ratio + l * places, of->by_scattering + l * places)
            .field != NULL) {
      return false;
    }
  }
  if (logarithms) {
    of->fit->model.loops->logarithms(of->count, of->model, of->ln_model);
  }
  q->factor = best_factor(of, logarithms);
  for (size_t l = 0; l < of->wavelengths; l++) {
    add_wavelength(of, l, q);
  }
  if (!of->fit->free_factor) {
    q->of_factor = 0;
  }
  for (size_t k = 0; k < n; k++) {
    q->along_factor[k] = q->of_factor > 0 ? q->along_factor[k] / q->of_factor : 0;
    for (size_t j = 0; j <= k; j++) {
      q->information[k][j] -= q->along_factor[k] * q->along_factor[j] * q->of_factor;
      q->information[j][k] = q->information[k][j];
    }
  }
  return q->chi_squared < (double)INFINITY;
}

/* ---- eigenvalues ----------------------------------------------------------------------------- */

/* Turns rows and columns p and q so that the number there becomes 0 (Jacobi 1846). */
static void rotate(double matrix[MOST][MOST], double vectors[MOST][MOST], size_t n, size_t p,
                   size_t q) {
  const double theta = (matrix[q][q] - matrix[p][p]) / (2 * matrix[p][q]);
  const double t = (theta < 0 ? -1 : 1) / (fabs(theta) + sqrt(fma(theta, theta, 1)));
  const double c = 1 / sqrt(fma(t, t, 1)), s = t * c;
  for (size_t i = 0; i < n; i++) {
    const double ip = matrix[i][p], iq = matrix[i][q];
    matrix[i][p] = c * ip - s * iq;
    matrix[i][q] = s * ip + c * iq;
  }
  for (size_t i = 0; i < n; i++) {
    const double pi = matrix[p][i], qi = matrix[q][i], vp = vectors[i][p], vq = vectors[i][q];
    matrix[p][i] = c * pi - s * qi;
    matrix[q][i] = s * pi + c * qi;
    vectors[i][p] = c * vp - s * vq;
    vectors[i][q] = s * vp + c * vq;
  }
}

/* Finds eigenvalues and eigenvectors. kept: unknowns that do not count, or NULL */
static void decompose(const struct quadratic *q, size_t n, const bool *kept, struct spectrum *to) {
  double matrix[MOST][MOST];
  for (size_t k = 0; k < n; k++) {
    const double own = q->information[k][k];
    to->scale[k] = own > 0 && (kept == NULL || !kept[k]) ? 1 / sqrt(own) : 0;
  }
  for (size_t k = 0; k < n; k++) {
    for (size_t j = 0; j < n; j++) {
      matrix[k][j] = q->information[k][j] * to->scale[k] * to->scale[j];
      to->vectors[k][j] = k == j;
    }
  }
  double off = 1;
  for (int sweep = 0; sweep < 30 && off > 0; sweep++) {
    off = 0;
    for (size_t p = 0; p < n; p++) {
      for (size_t j = p + 1; j < n; j++) {
        if (fabs(matrix[p][j]) > 1e-18) {
          off += fabs(matrix[p][j]);
          rotate(matrix, to->vectors, n, p, j);
        }
      }
    }
  }
  for (size_t k = 0; k < n; k++) {
    to->values[k] = matrix[k][k];
  }
}

/* Sets out[n] to the inverse of the information, with a damped diagonal, times in[n]. Returns in
 * times out. */
static double solve(const struct spectrum *by, size_t n, double damping, const double *in,
                    double *out) {
  double sum = 0;
  for (size_t k = 0; k < n; k++) {
    out[k] = 0;
  }
  for (size_t j = 0; j < n; j++) {
    double along = 0;
    for (size_t k = 0; k < n; k++) {
      along += by->vectors[k][j] * by->scale[k] * in[k];
    }
    const double value = real_max(by->values[j], ROUNDING) + damping;
    sum += along * along / value;
    for (size_t k = 0; k < n; k++) {
      out[k] += by->scale[k] * by->vectors[k][j] * (along / value);
    }
  }
  return sum;
}

/* ---- searching ------------------------------------------------------------------------------- */

/* Tries a step of the descent. Returns whether it is the last; *settled: whether it converged. */
static bool descend(core_spectral *of, bool *settled) {
  const size_t n = of->unknowns;
  struct quadratic *q = &of->now;
  struct spectrum by;
  struct quadratic next;
  bool kept[MOST] = {false};
  double x[MOST] = {0}, step[MOST], length = 0, fall = 0;
  for (size_t k = 0; k < n; k++) {
    kept[k] = (q->x[k] <= of->low[k] && q->to[k] < 0) || (q->x[k] >= of->high[k] && q->to[k] > 0);
  }
  decompose(q, n, kept, &by);
  solve(&by, n, of->damping, q->to, step);
  for (size_t k = 0; k < n; k++) {
    x[k] = clamp(q->x[k] + step[k], of->low[k], of->high[k]);
    step[k] = x[k] - q->x[k];
  }
  for (size_t k = 0; k < n; k++) {
    fall += 2 * step[k] * q->to[k];
    for (size_t j = 0; j < n; j++) {
      length += step[k] * step[j] * q->information[k][j];
    }
  }
  fall -= length;
  const bool valid = length > 0 && expand(of, x, q->logarithms, &next);
  *settled = !(length > 0);
  if (valid && next.chi_squared <= q->chi_squared) {
    const double fell = q->chi_squared - next.chi_squared;
    *settled = q->logarithms ? fell < FALL_NEAR * (double)of->count : length < STEP_END * STEP_END;
    of->damping = real_max(of->damping * (fell > 0.7 * fall   ? 0.1
                                          : fell < 0.2 * fall ? 3
                                                              : 1),
                           DAMPING_LEAST);
    *q = next;
  } else if (length > 0) {
    *settled = fall < FALL_ROUNDED * (1 + q->chi_squared);
    of->damping *= 5;
  }
  return *settled || --of->left <= 0 || of->damping > DAMPING_MOST;
}

/* The term of scattering that may have several solutions: a or, if that is given, b. */
static size_t scattering_of(const core_spectral *of) {
  return of->chromophores + !is_sought(&of->terms[of->chromophores]);
}

/* Compares candidate i: amounts and a, or else b, are other than their starts. The best of each a or b
 * starts a descent, since more and less scattering may give the same reading. */
static void compare(core_spectral *of, int i) {
  static const double amounts[] = {1, 0.25, 4}, scatterings[] = {0, -1, 1, -2, 2};
  struct minimum one = {.settled = false}, *start = &of->starts[i / 3];
  const size_t scattering = scattering_of(of);
  for (size_t k = 0; k < of->unknowns; k++) {
    const size_t term = of->term_of[k];
    const double from = of->terms[term].start;
    one.x[k] = clamp(term < of->chromophores ? from * amounts[i % 3]
                     : term == scattering    ? from + scatterings[i / 3]
                                             : from,
                     of->low[k], of->high[k]);
  }
  const bool valid = expand(of, one.x, true, &of->now);
  one.chi_squared = valid ? of->now.chi_squared : (double)INFINITY;
  if (i % 3 == 0 || one.chi_squared < start->chi_squared) {
    *start = one;
  }
}

/* Whether the next start is none, or the same as another one. */
static bool is_idle(const core_spectral *of) {
  const struct minimum *next = &of->starts[of->next];
  bool idle = !(next->chi_squared < (double)INFINITY);
  for (size_t k = 0; k < of->next; k++) {
    idle |= memcmp(of->starts[k].x, next->x, sizeof next->x) == 0;
  }
  return idle;
}

static void keep_minimum(core_spectral *of, bool settled) {
  struct minimum *one = &of->minima[of->minimum_count++];
  *one = (struct minimum){
      .chi_squared = of->now.chi_squared, .settled = settled, .probed = of->probe != NULL};
  memcpy(one->x, of->now.x, sizeof one->x);
  of->stage = BEGINS;
  if (of->probe != NULL) {
    *of->probe = of->usual;
    of->probe = NULL;
  }
}

static const struct minimum *best_minimum(const core_spectral *of) {
  const struct minimum *best = &of->minima[0];
  for (size_t i = 1; i < of->minimum_count; i++) {
    const bool better = of->minima[i].chi_squared < best->chi_squared;
    best = better && !of->minima[i].probed ? &of->minima[i] : best;
  }
  return best;
}

/* Begins the next probe: a descent in what is PROBE errors of a, or else of b, from the best minimum, on
 * one side. Returns whether there is any. */
static bool begin_probe(core_spectral *of) {
  const size_t n = of->unknowns, scattering = scattering_of(of);
  const double way = of->probes++ == 0 ? -PROBE : PROBE;
  const struct minimum *best = best_minimum(of);
  struct spectrum by;
  double unit[MOST] = {0}, row[MOST], from[MOST];
  size_t k = 0;
  while (k < n && of->term_of[k] != scattering) {
    k++;
  }
  if (k == n || of->minimum_count == 0 || !expand(of, best->x, false, &of->now)) {
    return false;
  }
  decompose(&of->now, n, NULL, &by);
  unit[k] = 1;
  const double error = sqrt(solve(&by, n, 0, unit, row)), at = best->x[k] + way * error;
  if (!(error > 0 && at > of->low[k] && at < of->high[k])) {
    return false;
  }
  for (size_t j = 0; j < n; j++) {
    from[j] = clamp(best->x[j] + way * row[j] / error, of->low[j], of->high[j]);
  }
  from[k] = at;
  if (!expand(of, from, false, &of->now) ||
      fabs(of->now.chi_squared - best->chi_squared - PROBE * PROBE) < PROBE_NEAR * PROBE * PROBE) {
    return false;
  }
  of->probe = way < 0 ? &of->high[k] : &of->low[k];
  of->usual = *of->probe;
  *of->probe = at;
  of->damping = DAMPING_FIRST;
  of->left = STEPS_MAX;
  return true;
}

/* Goes on to the next descent, with logarithms if there is one from this start. */
static void begin_descent(core_spectral *of, bool logarithms) {
  of->damping = DAMPING_FIRST;
  of->left = STEPS_MAX;
  const double *x = logarithms ? of->starts[of->next++].x : of->now.x;
  double from[MOST];
  memcpy(from, x, sizeof from);
  of->stage = !expand(of, from, logarithms, &of->now) ? BEGINS : logarithms ? COMES_NEAR : SETTLES;
}

/* Sets a result of which nothing is known. */
static void clear_result(const core_spectral *of, struct fit_wrong wrong,
                         core_spectral_result *result, double *residuals) {
  const double none = (double)NAN;
  const uint16_t refused = CORE_FIT_STATUS_REFUSED;
  *result = (core_spectral_result){
      refused, wrong.field, refused, refused, wrong.index, of->evaluations,
      none,    none,        none,    none,    none,        none,
      none,    none,        none,    none,    none,        .unknown_count = of->unknowns};
  for (size_t k = 0; k < of->unknowns; k++) {
    const unsigned property = of->terms[of->term_of[k]].property;
    result->unknown[k] = (core_spectral_estimate){(uint16_t)property, refused, 0, none, none, none};
    for (size_t j = 0; j < of->unknowns; j++) {
      result->covariance[k * of->unknowns + j] = none;
    }
  }
  for (size_t i = 0; residuals != NULL && i < of->count; i++) {
    residuals[i] = none;
  }
}

bool core_spectral_begin(core_spectral *of, const core_fit *places, const double *values,
                         const double *errors, core_spectral_result *result, double *residuals) {
  assert(places->count == of->places);
  of->fit = places;
  of->stage = COMPARES;
  of->evaluations = 0;
  of->candidate = 0;
  of->next = of->minimum_count = of->probes = 0;
  of->probe = NULL;
  of->values = values;
  of->errors = errors;
  const struct fit_wrong wrong = fit_check_set(of->count, values, errors);
  if (wrong.field != 0) {
    clear_result(of, wrong, result, residuals);
    return false;
  }
  of->fit->model.loops->logarithms(of->count, values, of->ln_values);
  return true;
}

/* ---- results --------------------------------------------------------------------------------- */

/* What results are made from. */
struct found {
  struct quadratic q;
  struct spectrum by;
  bool settled, plausible;
};

/* Sets *error and *shift to the standard error of a number whose derivatives by the unknowns are
 * `by`, and to what numerical errors of readings (in ln_model) may change it by; covariances[n] to those
 * with the unknowns. */
static void measure(const core_spectral *of, const struct found *at, const double *by,
                    double *error, double *shift, double *covariances) {
  double along = 0;
  *error = sqrt(solve(&at->by, of->unknowns, 0, by, covariances));
  *shift = 0;
  for (size_t k = 0; k < of->unknowns; k++) {
    along += covariances[k] * at->q.along_factor[k];
    if (!(at->by.scale[k] > 0) && (by[k] < 0 || by[k] > 0)) {
      *error = (double)INFINITY;
    }
  }
  for (size_t l = 0; l < of->wavelengths; l++) {
    struct chain all = {0, 0};
    for (size_t k = 0; k < of->unknowns; k++) {
      const struct chain one = chain_of(of, l, k);
      all.ratio = fma(covariances[k], one.ratio, all.ratio);
      all.scattering = fma(covariances[k], one.scattering, all.scattering);
    }
    for (size_t i = l * of->places; i < (l + 1) * of->places; i++) {
      const struct residual r = residual_of(of, &at->q, i);
      *shift += fabs(r.r * all.ratio + r.s * all.scattering - r.f * along) * of->ln_model[i];
    }
  }
}

/* Returns the status of what has this error, which is to be below most_error. */
static enum core_fit_status judge(const struct found *at, bool bound, double error, double shift,
                                  double most_error) {
  return !(error < most_error)           ? CORE_FIT_STATUS_UNDETERMINED
         : bound                         ? CORE_FIT_STATUS_AT_BOUND
         : !at->plausible                ? CORE_FIT_STATUS_IMPLAUSIBLE
         : at->settled && shift <= error ? CORE_FIT_STATUS_FITTED
                                         : CORE_FIT_STATUS_UNFINISHED;
}

static core_spectral_estimate estimate(unsigned property, enum core_fit_status status, double value,
                                       double error, double shift) {
  return (core_spectral_estimate){
      .property = (uint16_t)property,
      .status = (uint16_t)status,
      .value = status == CORE_FIT_STATUS_UNDETERMINED ? (double)NAN : value,
      .error = status == CORE_FIT_STATUS_FITTED || status == CORE_FIT_STATUS_UNFINISHED
                   ? error
                   : (double)INFINITY,
      .numerical = shift,
  };
}

/* Sets the estimate of unknown k, and its row of the covariances. */
static void put_unknown(const core_spectral *of, const struct found *at, size_t k,
                        core_spectral_result *result) {
  const size_t term = of->term_of[k], n = of->unknowns;
  const double x = at->q.x[k], range = of->high[k] - of->low[k];
  double by[MOST] = {0}, row[MOST], error, shift;
  by[k] = 1;
  measure(of, at, by, &error, &shift, row);
  error = error < ERROR_MOST * at->by.scale[k] ? error : (double)INFINITY;
  double most = CORE_SPECTRAL_SHARE_MOST * range;
  if (term < of->chromophores) {
    const double usual = real_max(x, of->terms[term].start);
    most = usual > 0 ? real_min(most, CORE_FIT_LN_ERROR_MAX * usual) : most;
  } else if (term == of->chromophores) {
    most = real_min(most, CORE_FIT_LN_ERROR_MAX);
  }
  const bool bound = at->q.outside || x <= of->low[k] || x >= of->high[k];
  const enum core_fit_status status = judge(at, bound, error, shift, at->q.factor > 0 ? most : 0);
  const bool is_a = term == of->chromophores;
  const double value = is_a ? real_exp_signed(x) : x, scale = is_a ? value : 1;
  result->unknown[k] =
      estimate(of->terms[term].property, status, value, scale * error, scale * shift);
  for (size_t j = 0; j < n; j++) {
    const double other = of->term_of[j] == of->chromophores ? real_exp_signed(at->q.x[j]) : 1;
    result->covariance[k * n + j] =
        j != k || isfinite(error) ? scale * other * row[j] : (double)INFINITY;
  }
}

/* Widens *error of the saturation, which bends where the total is vague, such that 2.5 of it are at least
 * how much it changes if amounts move along with it by two errors. row[]: its covariances with them. */
static void widen_share(const core_spectral *of, const double *x, const double *row, double *error,
                        double *shift) {
  const double oxy = term_at(of, x, of->oxy), share = oxy / (oxy + term_at(of, x, of->deoxy));
  double most = *error;
  for (int way = -1; way <= 1 && *error > 0 && *error < (double)INFINITY; way += 2) {
    double moved[MOST];
    for (size_t k = 0; k < of->unknowns; k++) {
      moved[k] = clamp(x[k] + 2 * way * row[k] / *error, of->low[k], of->high[k]);
    }
    const double part = term_at(of, moved, of->oxy), all = part + term_at(of, moved, of->deoxy);
    most = real_max(most, all > 0 ? fabs(part / all - share) / 2.5 : (double)INFINITY);
  }
  *shift *= most > *error ? most / *error : 1;
  *error = most;
}

/* Sets saturation and total. */
static void put_haemoglobin(const core_spectral *of, const struct found *at,
                            core_spectral_result *result) {
  double by_share[MOST] = {0}, by_total[MOST] = {0}, row[MOST], error, shift;
  bool sought = false, bound = at->q.outside;
  result->saturation_status = result->total_status = CORE_FIT_STATUS_UNDETERMINED;
  if (of->oxy >= of->chromophores || of->deoxy >= of->chromophores) {
    return;
  }
  const double oxy = term_at(of, at->q.x, of->oxy), deoxy = term_at(of, at->q.x, of->deoxy);
  const double total = oxy + deoxy;
  for (size_t k = 0; k < of->unknowns; k++) {
    if (of->term_of[k] == of->oxy || of->term_of[k] == of->deoxy) {
      sought = true;
      bound |= result->unknown[k].status == CORE_FIT_STATUS_AT_BOUND;
      by_total[k] = 1;
      by_share[k] = (of->term_of[k] == of->oxy ? deoxy : -oxy) / (total * total);
    }
  }
  if (sought && total > 0) {
    measure(of, at, by_share, &error, &shift, row);
    widen_share(of, at->q.x, row, &error, &shift);
    core_spectral_estimate one = estimate(
        0, judge(at, bound, error, shift, CORE_SPECTRAL_SHARE_MOST), oxy / total, error, 0);
    result->saturation_status = one.status;
    result->saturation = one.value;
    result->saturation_error = one.error;
    measure(of, at, by_total, &error, &shift, row);
    one = estimate(0, judge(at, bound, error, shift, total), total, error, 0);
    result->total_status = one.status;
    result->total = one.value;
    result->total_error = one.error;
  }
}

/* Sets the numerical errors of readings over their standard errors, in ln_model, and the largest of R;
 * and the model error. */
static void set_model_errors(core_spectral *of, const struct quadratic *q,
                             core_spectral_result *result) {
  result->model_error = 0;
  result->numerical_error = 0;
  for (size_t l = 0; l < of->wavelengths; l++) {
    double *errors = of->ln_model + l * of->places;
    const core_medium medium = fit_medium(&of->fit->model, of->media[l]);
    const double error = fit_model_error(&of->fit->model, &medium, &of->fit->places);
    const core_fault fault =
        fit_numerical_errors(&of->fit->model, of->media[l], &of->fit->places, errors);
    result->model_error = error > result->model_error || isnan(error) ? error : result->model_error;
    for (size_t i = 0; i < of->places; i++) {
      const size_t at = l * of->places + i;
      errors[i] = fault.field == NULL ? errors[i] : (double)INFINITY;
      result->numerical_error = real_max(result->numerical_error, errors[i]);
      const unsigned quantity = fit_quantity_of(&of->fit->places, i);
      errors[i] *= quantity == 0                     ? fabs(residual_of(of, q, at).f)
                   : quantity == CORE_QUANTITY_PHASE ? DEGREES / of->errors[at]
                                                     : of->model[at] / of->errors[at];
    }
  }
}

/* Makes what is fitted ambiguous if it has another value in a second solution. Returns whether it is. */
static bool differs(double value, double other, uint16_t *status, double *error) {
  const bool second = *status == CORE_FIT_STATUS_FITTED && fabs(other - value) > APART * *error;
  *status = second ? CORE_FIT_STATUS_AMBIGUOUS : *status;
  *error = second ? (double)INFINITY : *error;
  return second;
}

/* Takes another minimum that fits nearly as well for a second solution: what is fitted and differs there
 * is ambiguous. Returns whether there is any. */
static bool take_second(const core_spectral *of, const struct minimum *best,
                        const struct minimum *other, core_spectral_result *result) {
  bool second = false;
  if (!other->settled || other->chi_squared >= best->chi_squared + CORE_FIT_AMBIGUOUS) {
    return false;
  }
  for (size_t k = 0; k < of->unknowns; k++) {
    core_spectral_estimate *one = &result->unknown[k];
    const double unit = of->term_of[k] == of->chromophores ? one->value : 1;
    second |= differs(one->value, one->value + (other->x[k] - best->x[k]) * unit, &one->status,
                      &one->error);
  }
  if (of->oxy < of->chromophores && of->deoxy < of->chromophores) {
    const double oxy = term_at(of, other->x, of->oxy),
                 total = oxy + term_at(of, other->x, of->deoxy);
    second |= differs(result->saturation, total > 0 ? oxy / total : (double)INFINITY,
                      &result->saturation_status, &result->saturation_error);
    second |= differs(result->total, total, &result->total_status, &result->total_error);
  }
  return second;
}

static double condition_of(const struct spectrum *by, size_t n) {
  double least = (double)INFINITY, most = 0;
  for (size_t k = 0; k < n; k++) {
    least = real_min(least, by->values[k]);
    most = real_max(most, by->values[k]);
  }
  return least > ROUNDING ? sqrt(most / least) : (double)INFINITY;
}

static void put_result(core_spectral *of, core_spectral_result *result, double *residuals) {
  const struct minimum *best = best_minimum(of);
  struct found at = {.settled = best->settled};
  clear_result(of, (struct fit_wrong){0, 0}, result, residuals);
  if (of->minimum_count == 0 || !expand(of, best->x, false, &at.q)) {
    result->status = CORE_FIT_STATUS_UNFINISHED;
    for (size_t k = 0; k < of->unknowns; k++) {
      result->unknown[k].status = CORE_FIT_STATUS_UNFINISHED;
    }
    return;
  }
  const size_t n = of->unknowns, unknowns = n + of->fit->free_factor;
  const size_t spare = of->count > unknowns ? of->count - unknowns : 0;
  bool bound = false, vague = !(at.q.factor > 0), precise = true, second = false;
  at.plausible = at.q.chi_squared <= fit_chi_squared_most(spare);
  decompose(&at.q, n, NULL, &at.by);
  set_model_errors(of, &at.q, result);
  result->factor = at.q.factor;
  result->chi_squared = at.q.chi_squared;
  result->reduced_chi_squared = spare > 0 ? at.q.chi_squared / (double)spare : (double)NAN;
  result->condition = condition_of(&at.by, n);
  for (size_t k = 0; k < n; k++) {
    put_unknown(of, &at, k, result);
    bound |= result->unknown[k].status == CORE_FIT_STATUS_AT_BOUND;
    vague |= result->unknown[k].status == CORE_FIT_STATUS_UNDETERMINED;
    precise &= result->unknown[k].status != CORE_FIT_STATUS_UNFINISHED;
  }
  put_haemoglobin(of, &at, result);
  for (size_t i = 0; i < of->minimum_count; i++) {
    second |= take_second(of, best, &of->minima[i], result);
  }
  double row[MOST], unused, error;
  measure(of, &at, at.q.along_factor, &error, &unused, row);
  result->factor_error =
      at.q.of_factor > 0 ? at.q.factor * sqrt(1 / at.q.of_factor + error * error) : 0;
  result->status = fit_status(bound, !at.plausible, vague, best->settled && precise, second);
  for (size_t i = 0; residuals != NULL && i < of->count; i++) {
    residuals[i] = residual_of(of, &at.q, i).off;
  }
}

bool core_spectral_step(core_spectral *of, core_spectral_result *result, double *residuals) {
  bool settled = false;
  if (of->stage == COMPARES) {
    compare(of, of->candidate++);
    of->stage = of->candidate < CANDIDATES ? COMPARES : BEGINS;
  } else if (of->stage == BEGINS && of->next < STARTS && is_idle(of)) {
    of->next++;
  } else if (of->stage == BEGINS && of->next < STARTS) {
    begin_descent(of, true);
  } else if (of->stage == BEGINS && of->probes < 2) {
    of->stage = begin_probe(of) ? SETTLES : BEGINS;
  } else if (of->stage == BEGINS) {
    of->stage = ENDS;
  } else if (of->stage == COMES_NEAR && descend(of, &settled)) {
    begin_descent(of, false);
  } else if (of->stage == SETTLES && descend(of, &settled)) {
    keep_minimum(of, settled);
  } else if (of->stage == ENDS) {
    put_result(of, result, residuals);
    return false;
  }
  return true;
}
