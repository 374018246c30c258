/* A table is built from the source outwards, octave by octave, until nothing that single precision
 * can show is left of R; then for radii of given cdf, likewise from both ends of u. */
#include "core/lut/fit.h"

#include <math.h>
#include <stdlib.h>

#include "core/kernels.h"

/* Octaves below the scale of a profile where R follows its asymptote: 2^-34 is 6e-11. */
#define OCTAVES_BELOW 34

/* Single precision's normal exponents, with room for what pieces are multiplied by. */
enum {
  EXPONENT_MIN = -118,
  EXPONENT_MAX = 118,
  U_EXPONENT_MIN = -126,
  COMPLEMENT_EXPONENT_MIN = -24
};

/* Of the tolerance: what a fit may show; more may be found between the places that it looks at. */
#define FIT_SHARE 0.85

struct build {
  const core_profile *source;
  double tolerance;
  double scale; /* R over it is what the pieces hold */
  int first;    /* exponents of the radii's octaves */
  int last;     /* one more than the last one's */
  double word[CORE_LUT_R_OCTAVES];
  uint32_t entries[CORE_LUT_PIECES - CORE_LUT_R_OCTAVES];
  struct lut_pieces pieces;
  double error;
};

static const core_fault too_rough = {"tolerance", "larger: no table of this profile keeps it", 0};

/* ---- the functions ---------------------------------------------------------------------------- */

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

/* ---- where it begins and ends ----------------------------------------------------------------- */

/* How R goes on below 2^first: like 1 / r, like a constant, or rising by as much in each octave.
 * False: not as any of these, to the tolerance, down to 20 octaves less. */
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
  /* int_0^r 2 pi r (R + rise log2(first / r)) dr = pi r^2 (R + rise (log2(first / r) + 1 / (2 ln 2)))
   */
  const double per_rise = 0.72134752044448170368;
  const double factor = cdf_here / (first * first) / (R + rise * per_rise);
  b->word[CORE_LUT_NEAR_CDF] = factor * (R + rise * per_rise);
  b->word[CORE_LUT_NEAR_CDF_LOG] = factor * rise;
  return rise >= 0 && fabs(R + 20 * rise - deep) <= allowed * deep;
}

/* Logarithms round too coarsely for a cdf that must not turn back: where R rises like one, the pieces
 * go on to where nothing is left of the cdf. */
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

/* Further in when what is near the source is smaller than the profile's scale. */
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

/* Over the least scale that there is, R of next to no light is less than this, and has no digits. */
#define SCALED_LEAST 0x1p-60

/* So that the largest R fits into pieces and the smallest is kept as far down as can be. */
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

/* Whether R and 2 pi r R have underflowed at a radius, in their own units and over the albedo. */
static bool is_nothing(const struct build *b, double r) {
  const double factor = fmax(1, 6.3 * r * fmax(1, 1 / b->source->albedo));
  return value(b, CORE_QUANTITY_R, r) * factor < 0x1p-150;
}

/* Far away R has underflowed or falls like 1 / r^3. */
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

/* ---- gathering -------------------------------------------------------------------------------- */

static core_fault from_fit(enum lut_fit fit) {
  return fit == LUT_FITTED      ? (core_fault){0}
         : fit == LUT_NO_MEMORY ? CORE_OUT_OF_MEMORY
                                : too_rough;
}

/* Octaves from first to last - 1 of a subject; `octaves` is the word of exponent -127's entry. The
 * number of cuts of an octave is sought from next to that of the one before. */
static core_fault gather(struct build *b, const struct lut_subject *subject, uint32_t octaves,
                         int first, int last) {
  unsigned cuts = 0;
  struct lut_subject stricter = *subject;
  stricter.tolerance *= FIT_SHARE;
  for (int exponent = first; exponent < last; exponent++) {
    uint32_t entry;
    cuts = cuts > 0 ? cuts - 1 : 0;
    const enum lut_fit fit = lut_fit_octave(&stricter, exponent, &cuts, &b->pieces, &entry);
    if (fit != LUT_FITTED) {
      return from_fit(fit);
    }
    b->entries[octaves - CORE_LUT_R_OCTAVES + (uint32_t)(exponent + 127)] = entry;
  }
  return (core_fault){0};
}

/* What the pieces of octaves are off by, wherever it is looked for. */
static core_fault measure(struct build *b, const struct lut_subject *subject, uint32_t octaves,
                          int first, int last) {
  for (int exponent = first; exponent < last; exponent++) {
    const uint32_t entry = b->entries[octaves - CORE_LUT_R_OCTAVES + (uint32_t)(exponent + 127)];
    const double error = lut_fit_error(subject, exponent, entry, &b->pieces);
    if (!(error <= subject->tolerance)) {
      return too_rough;
    }
    b->error = fmax(b->error, error);
  }
  return (core_fault){0};
}

static core_fault gather_R(struct build *b) {
  const double factor = fmax(1, ldexp(6.3, b->last) * fmax(1, 1 / b->source->albedo));
  const struct lut_subject subject = {
      .function = scaled_R,
      .context = b,
      .tolerance = b->tolerance,
      /* eight of the smallest numbers, where R cannot show in any quantity, and far beyond */
      .negligible = 0x1p-146 / factor / b->scale,
  };
  core_fault fault = gather(b, &subject, CORE_LUT_R_OCTAVES, b->first, b->last);
  if (fault.field == NULL) {
    fault = measure(b, &subject, CORE_LUT_R_OCTAVES, b->first, b->last);
  }
  return fault;
}

static core_fault gather_cdf(struct build *b) {
  const struct lut_subject subject = {
      .function = cdf,
      .context = b,
      .tolerance = b->tolerance,
      .negligible = 0x1p-146, /* eight of the smallest numbers */
      .monotone = true,
  };
  core_fault fault = gather(b, &subject, CORE_LUT_CDF_OCTAVES, b->first, b->last);
  if (fault.field == NULL) {
    fault = measure(b, &subject, CORE_LUT_CDF_OCTAVES, b->first, b->last);
  }
  return fault;
}

/* The least exponent of u whose radii are normal numbers. */
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

/* Up to 1/2 by u, from there on by 1 - u. */
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
    fault =
        from_fit(lut_fit_constant((float)middle, &b->pieces,
                                  &b->entries[CORE_LUT_RADIUS_OCTAVES - CORE_LUT_R_OCTAVES + 126]));
  }
  if (fault.field == NULL) {
    fault = gather(b, &far, CORE_LUT_COMPLEMENT_OCTAVES, COMPLEMENT_EXPONENT_MIN, -1);
  }
  if (fault.field == NULL) {
    fault = measure(b, &near, CORE_LUT_RADIUS_OCTAVES, first, -1);
  }
  if (fault.field == NULL) {
    fault = measure(b, &far, CORE_LUT_COMPLEMENT_OCTAVES, COMPLEMENT_EXPONENT_MIN, -1);
  }
  const double u = ldexp(1, first);
  double r;
  radius(b, 1, &u, &r);
  b->word[CORE_LUT_FIRST_U] = u;
  b->word[CORE_LUT_NEAR_RADIUS] = b->word[CORE_LUT_NEAR_POWER] > 0 ? r / u : r / sqrt(u);
  return fault;
}

/* ---- the table -------------------------------------------------------------------------------- */

static core_fault gather_all(struct build *b) {
  if (!find_first(b) || !set_scale(b) || !find_last(b)) {
    return too_rough;
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

/* Nothing scatters: 0 everywhere. */
static core_fault gather_nothing(struct build *b) {
  b->word[CORE_LUT_FIRST_MM] = 1;
  b->word[CORE_LUT_LAST_MM] = 1;
  b->word[CORE_LUT_SCALE] = 1;
  return (core_fault){0};
}

static core_fault assemble(const struct build *b, core_lut *lut) {
  lut->count = CORE_LUT_PIECES + b->pieces.count * CORE_LUT_TERMS;
  lut->words = malloc(lut->count * sizeof *lut->words);
  if (lut->words == NULL) {
    return CORE_OUT_OF_MEMORY;
  }
  for (int i = 0; i < CORE_LUT_R_OCTAVES; i++) {
    lut->words[i] = (float)b->word[i];
    if (!isfinite(lut->words[i])) {
      free(lut->words);
      return too_rough;
    }
  }
  memcpy(&lut->words[CORE_LUT_R_OCTAVES], b->entries, sizeof b->entries);
  memcpy(&lut->words[CORE_LUT_PIECES], b->pieces.c,
         b->pieces.count * CORE_LUT_TERMS * sizeof *lut->words);
  lut->error = b->error;
  return (core_fault){0};
}

core_fault core_lut_build(core_lut *lut, const core_profile *source, double tolerance) {
  struct build b = {.source = source, .tolerance = tolerance};
  /* The first piece is for arguments outside, whose values are replaced. */
  uint32_t outside;
  core_fault fault = from_fit(lut_fit_constant(0, &b.pieces, &outside));
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
