/* Builds a table octave by octave. The pieces of R and cdf begin near the source and end where R is
 * too small for single precision or follows its asymptote. The pieces of the radius for a cdf begin
 * at both ends of u, 0 and 1, and end at u = 1/2. */
#include "core/lut/fit.h"

#include <math.h>
#include <stdlib.h>

#include "core/kernels.h"

/* The pieces begin at the scale of the profile times 2^-34 = 6e-11, where R follows its asymptote.
 */
#define OCTAVES_BELOW 34

/* The range of exponents of the octaves. It is narrower than single precision's, so that the
 * products of a piece with its factors stay in range. */
enum {
  EXPONENT_MIN = -118,
  EXPONENT_MAX = 118,
  U_EXPONENT_MIN = -126,
  COMPLEMENT_EXPONENT_MIN = -24
};

/* The tolerance of a fit is the table's times this, because the error may be larger between the
 * places that the fit looks at. */
#define FIT_SHARE 0.85

struct build {
  const core_profile *source;
  double tolerance;
  double scale; /* the pieces hold R / scale */
  int first;    /* exponent of the first octave of the radii */
  int last;     /* exponent of the last octave plus 1 */
  double word[CORE_LUT_R_OCTAVES];
  uint32_t entries[CORE_LUT_PIECES - CORE_LUT_R_OCTAVES];
  struct lut_pieces pieces;
  double error;
};

/* ---- the functions --------------------------------------------------------------------------- */

static void scaled_R(const void *context, size_t n, const double *x, double *y) {
  const struct build *b = context;
  core_evaluate(b->source, CORE_QUANTITY_R, n, x, y);
  for (size_t i = 0; i < n; i++) {
    y[i] /= b->scale;
  }
}

static void cdf(const void *context, size_t n, const double *x, double *y) {
  const struct build *b = context;
  core_evaluate(b->source, CORE_QUANTITY_CDF, n, x, y);
}

static void radius(const void *context, size_t n, const double *u, double *r) {
  const struct build *b = context;
  core_sample_f64(b->source, n, u, r);
}

static void radius_of_complement(const void *context, size_t n, const double *v, double *r) {
  double u[16];
  for (size_t i = 0; i < n; i++) {
    u[i] = 1 - v[i];
  }
  radius(context, n, u, r);
}

static double value(const struct build *b, enum core_quantity quantity, double r) {
  double v;
  core_evaluate(b->source, quantity, 1, &r, &v);
  return v;
}

/* ---- where it begins and ends ---------------------------------------------------------------- */

/* Finds the asymptote of R below 2^first: like 1 / r, constant, or rising by the same amount in
 * each octave. Returns false if R follows none of these, to the tolerance, for 20 octaves down. */
static bool set_near(struct build *b) {
  const double first = ldexp(1, b->first);
  const double R = value(b, CORE_QUANTITY_R, first);
  const double half = value(b, CORE_QUANTITY_R, first / 2);
  const double deep = value(b, CORE_QUANTITY_R, ldexp(first, -20));
  const double allowed = 0.25 * b->tolerance;
  const double cdf_here = value(b, CORE_QUANTITY_CDF, first);
  b->word[CORE_LUT_FIRST_MM] = first;
  if (fabs(half - 2 * R) <= allowed * R && fabs(ldexp(deep, -20) - R) <= allowed * R) {
    b->word[CORE_LUT_NEAR_POWER] = 1;
    b->word[CORE_LUT_NEAR_R] = R * first;
    b->word[CORE_LUT_NEAR_CDF] = cdf_here / first;
    return true;
  }
  const double rise = fabs(half - R) <= 1e-12 * R ? 0 : half - R;
  b->word[CORE_LUT_NEAR_POWER] = 0;
  b->word[CORE_LUT_NEAR_R] = R;
  b->word[CORE_LUT_NEAR_LOG] = rise;
  /* The integral of 2 pi r (R + rise log2(first / r)) from 0 to r is
 * pi r^2 (R + rise (log2(first / r) + 1 / (2 ln 2))). */
  const double per_rise = 0.72134752044448170368;
  const double factor = cdf_here / (first * first) / (R + rise * per_rise);
  b->word[CORE_LUT_NEAR_CDF] = factor * (R + rise * per_rise);
  b->word[CORE_LUT_NEAR_CDF_LOG] = factor * rise;
  return rise >= 0 && fabs(R + 20 * rise - deep) <= allowed * deep;
}

/* A cdf from a rounded logarithm would not be monotone. So where R rises like a logarithm, the
 * pieces begin at radii so small that the cdf underflows below them. */
static void lower_first(struct build *b) {
  while (b->word[CORE_LUT_NEAR_LOG] > 0 && b->first - 4 >= EXPONENT_MIN &&
         value(b, CORE_QUANTITY_CDF, ldexp(1, b->first)) >= 0x1p-150) {
    b->first -= 4;
    if (!set_near(b)) {
      b->first += 4;
      set_near(b);
      return;
    }
  }
}

/* Finds the first octave. It moves to smaller radii if R does not yet follow an asymptote there. */
static bool find_first(struct build *b) {
  b->first = ilogb(b->source->scale_mm) - OCTAVES_BELOW;
  for (; b->first >= EXPONENT_MIN; b->first -= 8) {
    if (set_near(b)) {
      lower_first(b);
      return true;
    }
  }
  return false;
}

/* A profile with so little light that R / 2^-126 near the source is less than this is refused,
 * since R has no digits left. */
#define SCALED_LEAST 0x1p-60

/* Sets the scale such that the largest R / scale fits into a piece, and small R keep their digits
 * as long as possible. Returns false if no table is possible. */
static bool set_scale(struct build *b) {
  while (value(b, CORE_QUANTITY_R, ldexp(1, b->first)) > 0x1p120) {
    b->first++;
  }
  if (!set_near(b)) {
    return false;
  }
  const double R = value(b, CORE_QUANTITY_R, ldexp(1, b->first));
  if (!(R >= SCALED_LEAST * 0x1p-126)) {
    return false;
  }
  const int size = ilogb(R);
  const int up = size > 120 ? 0 : 120 - size;
  b->scale = ldexp(1, up > 126 ? -126 : -up);
  b->word[CORE_LUT_NEAR_R] /= b->scale;
  b->word[CORE_LUT_NEAR_LOG] /= b->scale;
  return true;
}

/* Returns whether R, 2 pi r R and the pdf have all underflowed at the radius r. */
static bool is_nothing(const struct build *b, double r) {
  const double factor = fmax(1, 6.3 * r * fmax(1, 1 / b->source->albedo));
  return value(b, CORE_QUANTITY_R, r) * factor < 0x1p-150;
}

/* Finds the last octave. Returns true if R beyond it has underflowed or falls like 1 / r^3. */
static bool find_last(struct build *b) {
  b->last = b->first + 1;
  while (b->last < EXPONENT_MAX && !is_nothing(b, ldexp(1, b->last)) &&
         value(b, CORE_QUANTITY_R, ldexp(1, b->last)) / b->scale > 0x1p-110) {
    b->last++;
  }
  const double last = ldexp(1, b->last);
  const double R = value(b, CORE_QUANTITY_R, last);
  b->word[CORE_LUT_LAST_MM] = last;
  b->word[CORE_LUT_FAR] = 0;
  if (is_nothing(b, last)) {
    return true;
  }
  b->word[CORE_LUT_FAR] = R / b->scale;
  return fabs(8 * value(b, CORE_QUANTITY_R, 2 * last) - R) <= 1e-6 * R;
}

/* ---- gathering ------------------------------------------------------------------------------- */

/* Fits the octaves from first to last - 1 of a subject, and raises b->error to the largest error found
 * in them. `octaves` is the word that holds the entry of exponent -127. The search for the number of
 * cuts of an octave begins near the result of the one before. */
static core_fault gather(struct build *b, const struct lut_subject *subject, uint32_t octaves,
                         int first, int last) {
  unsigned cuts = 0;
  struct lut_subject stricter = *subject;
  stricter.tolerance *= FIT_SHARE;
  core_fault fault = {0};
  for (int exponent = first; fault.field == NULL && exponent < last; exponent++) {
    uint32_t *entry = &b->entries[octaves - CORE_LUT_R_OCTAVES + (uint32_t)(exponent + 127)];
    const size_t pieces_before = b->pieces.count;
    double error = (double)INFINITY;
    cuts = cuts > 0 ? cuts - 1 : 0;
    /* Between the places where a fit looks, it may be worse than the tolerance: then cut once more. */
    for (; fault.field == NULL && !(error <= subject->tolerance); cuts++) {
      b->pieces.count = pieces_before;
      fault = lut_fit_octave(&stricter, exponent, &cuts, &b->pieces, entry);
      if (fault.field == NULL) {
        error = lut_fit_error(subject, exponent, *entry, &b->pieces, b->error);
      }
    }
    cuts--;
    b->error = fault.field == NULL ? fmax(b->error, error) : b->error;
  }
  return fault;
}

static core_fault gather_R(struct build *b) {
  const double factor = fmax(1, ldexp(6.3, b->last) * fmax(1, 1 / b->source->albedo));
  const struct lut_subject subject = {
      .function = scaled_R,
      .context = b,
      .tolerance = b->tolerance,
      /* An absolute error is negligible below 8 times the smallest positive number in any quantity
       * derived from R. */
      .negligible = 0x1p-146 / factor / b->scale,
  };
  return gather(b, &subject, CORE_LUT_R_OCTAVES, b->first, b->last);
}

static core_fault gather_cdf(struct build *b) {
  const struct lut_subject subject = {
      .function = cdf,
      .context = b,
      .tolerance = b->tolerance,
      .negligible = 0x1p-146, /* 8 times the smallest positive number */
      .monotone = true,
  };
  return gather(b, &subject, CORE_LUT_CDF_OCTAVES, b->first, b->last);
}

/* Returns the least exponent of u at which the radius is a normal number. */
static int first_u(const struct build *b) {
  int exponent = U_EXPONENT_MIN;
  for (;; exponent++) {
    const double u = ldexp(1, exponent);
    double r;
    radius(b, 1, &u, &r);
    if (r >= 0x1p-110 || exponent == -2) {
      return exponent;
    }
  }
}

/* Where R rises like a logarithm, the radii below FIRST_U follow from NEAR_CDF and NEAR_CDF_LOG in
 * single precision, which may put them up to 2 units in the last place too high. This lowers them
 * by as much, so that the last of them does not exceed the first piece. Nothing else depends on
 * these words then: the cdf itself has underflowed. */
static void keep_order_at_first_u(struct build *b) {
  const double slack = 0x1p-22; /* twice the unit in the last place, relative */
  if (b->word[CORE_LUT_NEAR_LOG] > 0 &&
      value(b, CORE_QUANTITY_CDF, b->word[CORE_LUT_FIRST_MM]) < 0x1p-150) {
    b->word[CORE_LUT_NEAR_CDF] *= 1 + 2 * slack;
    b->word[CORE_LUT_NEAR_CDF_LOG] *= 1 + 2 * slack;
    b->error = fmax(b->error, 2 * slack);
  }
}

/* Fits the radius as a function of u for u up to 1/2, and of 1 - u above. */
static core_fault gather_radius(struct build *b) {
  const double half = 0.5;
  double middle;
  radius(b, 1, &half, &middle);
  const struct lut_subject near = {
      .function = radius, .context = b, .tolerance = b->tolerance, .monotone = true};
  const struct lut_subject far = {
      .function = radius_of_complement, .context = b, .tolerance = b->tolerance, .monotone = true};
  const int first = first_u(b);
  core_fault fault = gather(b, &near, CORE_LUT_RADIUS_OCTAVES, first, -1);
  if (fault.field == NULL) {
    fault = lut_fit_constant((float)middle, &b->pieces,
                             &b->entries[CORE_LUT_RADIUS_OCTAVES - CORE_LUT_R_OCTAVES + 126]);
  }
  if (fault.field == NULL) {
    fault = gather(b, &far, CORE_LUT_COMPLEMENT_OCTAVES, COMPLEMENT_EXPONENT_MIN, -1);
  }
  const double u = ldexp(1, first);
  double r;
  radius(b, 1, &u, &r);
  b->word[CORE_LUT_FIRST_U] = u;
  b->word[CORE_LUT_NEAR_RADIUS] = b->word[CORE_LUT_NEAR_POWER] > 0 ? r / u : r / sqrt(u);
  keep_order_at_first_u(b);
  return fault;
}

/* ---- the table ------------------------------------------------------------------------------- */

static core_fault gather_all(struct build *b) {
  if (!find_first(b) || !set_scale(b) || !find_last(b)) {
    return lut_too_rough;
  }
  const double two_pi = 6.28318530717958647693;
  b->word[CORE_LUT_SCALE] = b->scale;
  b->word[CORE_LUT_RING_SCALE] = two_pi * b->scale;
  b->word[CORE_LUT_PDF_SCALE] = two_pi * b->scale / b->source->albedo;
  b->word[CORE_LUT_LIMIT] = 1;
  core_fault fault = gather_R(b);
  if (fault.field == NULL) {
    fault = gather_cdf(b);
  }
  return fault.field == NULL ? gather_radius(b) : fault;
}

/* Makes the table of a medium that scatters nothing: all values are 0. */
static core_fault gather_nothing(struct build *b) {
  b->word[CORE_LUT_FIRST_MM] = 1;
  b->word[CORE_LUT_LAST_MM] = 1;
  b->word[CORE_LUT_SCALE] = 1;
  return (core_fault){0};
}

static core_fault assemble(const struct build *b, core_lut *lut) {
  const size_t samples_at = CORE_LUT_PIECES + b->pieces.count * CORE_LUT_TERMS;
  lut->count = samples_at + CORE_LUT_SAMPLE_WORDS;
  lut->words = malloc(lut->count * sizeof *lut->words);
  if (lut->words == NULL) {
    return CORE_OUT_OF_MEMORY;
  }
  for (int i = 0; i < CORE_LUT_R_OCTAVES; i++) {
    lut->words[i] = (float)b->word[i];
    if (!isfinite(lut->words[i])) {
      free(lut->words);
      return lut_too_rough;
    }
  }
  memcpy(&lut->words[CORE_LUT_R_OCTAVES], b->entries, sizeof b->entries);
  memcpy(&lut->words[CORE_LUT_PIECES], b->pieces.c,
         b->pieces.count * CORE_LUT_TERMS * sizeof *lut->words);
  double r[CORE_LUT_SAMPLES], R[CORE_LUT_SAMPLES];
  core_lut_samples(b->source, r, R);
  lut->words[CORE_LUT_SAMPLES_MM] = (float)r[0];
  memcpy(&lut->words[samples_at], R, sizeof R);
  lut->error = b->error;
  return (core_fault){0};
}

core_fault core_lut_build(core_lut *lut, const core_profile *source, double tolerance) {
  struct build b = {.source = source, .tolerance = tolerance};
  /* Entries of octaves without pieces point to the first piece. The kernels then use the asymptotes
   * in place of its values. */
  uint32_t outside;
  core_fault fault = lut_fit_constant(0, &b.pieces, &outside);
  for (size_t i = 0; i < sizeof b.entries / sizeof b.entries[0]; i++) {
    b.entries[i] = CORE_LUT_ENTRY(0, CORE_LUT_MANTISSA_BITS);
  }
  if (fault.field == NULL) {
    fault = source->albedo > 0 ? gather_all(&b) : gather_nothing(&b);
  }
  if (fault.field == NULL) {
    fault = assemble(&b, lut);
  }
  free(b.pieces.c);
  return fault;
}
