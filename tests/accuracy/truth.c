/* truth [SECONDS [SEED]]: is every stated error true?
 *
 * Until the time is over, a model, a medium, moments and parameters are drawn from the whole domain,
 * more often from the usual part of it. Each evaluator's values at random radii are compared with
 * the model's formula in 113 bits (the dipoles: in MPFR, tests/accuracy/reference.c), written as the
 * papers print it or integrated another way than the kernels do, and the difference with the error
 * that the profile states. Two models have no such formula: `transport` is compared with itself at
 * its tightest tolerance, and `gaussians` with the model that it was fitted to.
 *
 * The program prints its seed, how many values of each class it compared, and each class's largest
 * error as a share of what was stated. Its exit status is 1 if one was larger than stated.
 */
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "core/kernels.h"
#include "tests/accuracy/reference.h"

typedef _Float128 quad;

/* ---- random numbers (Vigna's splitmix64) --------------------------------------------------------- */

static uint64_t random_bits(uint64_t *state) {
  uint64_t z = (*state += UINT64_C(0x9e3779b97f4a7c15));
  z = (z ^ (z >> 30)) * UINT64_C(0xbf58476d1ce4e5b9);
  z = (z ^ (z >> 27)) * UINT64_C(0x94d049bb133111eb);
  return z ^ (z >> 31);
}

static size_t below(uint64_t *state, size_t limit) {
  return (size_t)(random_bits(state) % limit);
}

static double between(uint64_t *state, double low, double high) {
  return low + (high - low) * ((double)(random_bits(state) >> 11) * 0x1p-53);
}

static double log_between(uint64_t *state, double low, double high) {
  return exp(between(state, log(low), log(high)));
}

static const quad pi = 3.14159265358979323846264338327950288Q;

/* ---- what is drawn ----------------------------------------------------------------------------- */

enum family { DIPOLE, EXTENDED, QUANTIZED, SINGLE, BURLEY, SKIN, SLAB, FIT, TRANSPORT, SUM };

static const struct formula {
  unsigned id;
  const char *name;
  int variant;
  unsigned parts[2]; /* of a sum */
} formulas[] = {
#define CORE_MODEL(id, IDENT, name, formula, kernels, variant, parameters, source)                 \
  {id, #formula, variant, {0}},
#define CORE_SUM(id, IDENT, name, FIRST, SECOND, source)                                           \
  {id, "sum", 0, {CORE_MODEL_##FIRST, CORE_MODEL_##SECOND}},
#include "core/models.def"
};
enum { MODELS = sizeof formulas / sizeof formulas[0], EVALUATORS = 3 };

static enum family family_of(const struct formula *formula) {
  static const char *const names[] = {"dipole",    "extended", "",    "single",    "burley",
                                      "gaussians", "cloud",    "fit", "transport", "sum"};
  if (formula->id == CORE_MODEL_QUANTIZED) {
    return QUANTIZED;
  }
  for (enum family f = DIPOLE;; f++) {
    if (strcmp(formula->name, names[f]) == 0) {
      return f;
    }
  }
}

static const struct formula *formula_of(unsigned model) {
  size_t i = 0;
  while (formulas[i].id != model) {
    i++;
  }
  return &formulas[i];
}

struct subject {
  const struct formula *formula;
  enum family family;
  enum core_moments moments;
  core_medium medium;
  core_parameters parameters;
  quad sigma_t_prime, scattered, absorbed; /* 1/mm; the others per sigma_t' */
  quad diffusion, mu, two_zb, c_phi, c_flux, prefactor;
  quad albedo; /* NaN: not known */
  quad S_per_R;
};

static quad to_quad(const mpfr_t x) {
  if (!mpfr_regular_p(x)) {
    return (quad)mpfr_get_d(x, MPFR_RNDN);
  }
  mpfr_t rest;
  mpfr_init2(rest, mpfr_get_prec(x));
  const long exponent = mpfr_get_exp(x);
  mpfr_mul_2si(rest, x, -exponent, MPFR_RNDN);
  quad sum = 0;
  for (int i = 0; i < 3; i++) {
    const double part = mpfr_get_d(rest, MPFR_RNDN);
    sum += (quad)part;
    mpfr_sub_d(rest, rest, part, MPFR_RNDN);
  }
  mpfr_clear(rest);
  return scalbnf128(sum, exponent < -30000 ? -30000 : exponent > 30000 ? 30000 : (int)exponent);
}

/* Fresnel's transmittance from outside, unpolarized. */
static quad transmittance(quad eta, quad outside) {
  const quad squared = 1 - (1 - outside * outside) / (eta * eta);
  if (squared <= 0 || outside <= 0) {
    return 0;
  }
  const quad inside = sqrtf128(squared);
  const quad s = eta * inside + outside;
  const quad p = eta * outside + inside;
  return 2 * eta * inside * outside * (1 / (s * s) + 1 / (p * p));
}

/* The coefficients of d'Eon 2012, Table 2, in mean free paths. */
static void set_table_2(struct subject *s) {
  const core_medium *m = &s->medium;
  const enum family family = s->family;
  const int switches = family == SLAB || family == DIPOLE ? s->formula->variant : 7;
  const reference_fresnel *fresnel = reference_fresnel_moments(s->moments, m->eta);
  const quad lost1 = to_quad(fresnel->one_minus_2c1);
  const quad lost2 = to_quad(fresnel->one_minus_3c2);
  const quad sigma_s_prime = (quad)m->sigma_s_per_mm * (1 - (quad)m->g);
  s->sigma_t_prime = (quad)m->sigma_a_per_mm + sigma_s_prime;
  s->absorbed = (quad)m->sigma_a_per_mm / s->sigma_t_prime;
  s->scattered = sigma_s_prime / s->sigma_t_prime;
  s->diffusion = (switches & CORE_DIPOLE_GROSJEAN) != 0 ? (1 + s->absorbed) / 3 : (quad)1 / 3;
  s->prefactor =
      (switches & CORE_DIPOLE_GROSJEAN) != 0 ? s->scattered * s->scattered : s->scattered;
  s->mu = sqrtf128(s->absorbed / s->diffusion);
  const quad lost = (switches & CORE_DIPOLE_BOUNDARY) != 0 ? lost2 : lost1;
  s->two_zb = 4 * (2 - lost) / lost1 * s->diffusion;
  s->c_phi = (switches & CORE_DIPOLE_EXITANCE) != 0 ? lost1 / 4 : 0;
  s->c_flux = (switches & CORE_DIPOLE_EXITANCE) != 0 ? lost2 / 2 : 1;
}

/* ---- the models' formulas ---------------------------------------------------------------------- */

/* At one radius: R e^shift, -dR/dr e^shift, the energy within r, and that over the albedo. NaN: not
 * known. */
struct truth {
  quad R, slope, shift, cdf;
};

static reference_dipole dipole;
static reference_values dipole_values;

static struct truth dipole_truth(struct subject *s, double r) {
  reference_dipole_evaluate(&dipole, r, &dipole_values);
  const quad ln_R = to_quad(dipole_values.of[CORE_ELEMENTWISE_LN_R]);
  s->albedo = to_quad(dipole.albedo);
  const quad shift = ln_R < -10000 && !isinf(ln_R) ? -ln_R : 0;
  return (struct truth){
      .R = shift > 0 ? 1 : to_quad(dipole_values.of[CORE_ELEMENTWISE_R]),
      .slope = shift > 0 ? 0 : -to_quad(dipole_values.of[CORE_ELEMENTWISE_SLOPE]),
      .shift = shift,
      .cdf = to_quad(dipole_values.of[CORE_ELEMENTWISE_CDF]),
  };
}

/* The integral over depth z = e^s by the trapezoidal rule. */
static struct truth extended_truth(struct subject *s, double r) {
  const bool kappa = s->family == EXTENDED && s->formula->variant == 1;
  const quad x = (quad)r * s->sigma_t_prime, mu = s->mu, step = 0.19Q;
  const quad source = s->prefactor / (4 * pi);
  const quad share = -expm1f128(-mu * s->two_zb), mirrored = 1 - share;
  const quad spread = mu > 0 ? share / mu : s->two_zb;
  const quad all = s->c_flux * (1 + mirrored) + s->c_phi / s->diffusion * spread;
  s->albedo = kappa ? (quad)NAN : s->prefactor / 2 * all / (1 + mu);
  quad R = 0, slope = 0, energy = 0;
  const quad near = fmaxf128(fminf128(x, 1), 1e-60Q);
  for (quad t = logf128(near) - 50; t < 4.6Q; t += step) {
    const quad z = expf128(t), z2 = z + s->two_zb;
    const quad d1 = hypotf128(x, z), d2 = hypotf128(x, z2);
    const quad a1 = x * (x / (d1 + z)), a2 = x * (x / (d2 + z2));
    const quad e1 = expf128(-mu * (d1 - x) - z), e2 = expf128(-mu * (d2 - x) - z);
    const quad apart = s->two_zb * (z + z2) / (d1 + d2);
    const quad f1 = e1 / d1, f2 = e2 / d2;
    const quad g1 = f1 / d1 * (mu + 1 / d1), g2 = f2 / d2 * (mu + 1 / d2);
    const quad h1 = f1 * (mu * mu + 3 * mu / d1 + 3 / (d1 * d1)) / (d1 * d1);
    const quad h2 = f2 * (mu * mu + 3 * mu / d2 + 3 / (d2 * d2)) / (d2 * d2);
    /* f1 - f2 and g1 - g2 with the digits of d2 - d1 */
    const quad lost = -expm1f128(-mu * apart), i1 = 1 / d1, i2 = 1 / d2;
    const quad fluence = e1 * i1 * i2 * (apart + d1 * lost);
    const quad squares = apart * i1 * i2 * (i1 + i2);
    const quad steeper = e1 * (mu * squares + apart * i1 * i2 * (i1 * i1 + i1 * i2 + i2 * i2) +
                               (mu * i2 * i2 + i2 * i2 * i2) * lost);
    const quad braces = s->c_phi / s->diffusion * fluence + s->c_flux * (z * g1 + z2 * g2);
    const quad steep = x * (s->c_phi / s->diffusion * steeper + s->c_flux * (z * h1 + z2 * h2));
    const quad factor = kappa ? -expm1f128(-2 * (d1 + z)) : 1;
    const quad rising = kappa ? 2 * x / d1 * expf128(-2 * (d1 + z)) : 0;
    R += z * factor * braces;
    slope += z * (factor * steep - rising * braces);
    const quad gone1 = -expm1f128(-mu * a1), gone2 = -expm1f128(-mu * a2);
    const quad flux = (a1 + z * gone1) / d1 + mirrored * (a2 + z2 * gone2) / d2;
    const quad left = expf128(-mu * a1) * (mu > 0 ? lost / mu : apart);
    const quad phi = x > 1 ? spread - left : mu > 0 ? (gone1 - mirrored * gone2) / mu : a1 - a2;
    energy += z * expf128(-z * (1 + mu)) * (s->c_flux * flux + s->c_phi / s->diffusion * phi);
  }
  const quad squared = s->sigma_t_prime * s->sigma_t_prime;
  return (struct truth){.R = r > 0 ? source * squared * step * R : (quad)INFINITY,
                        .slope = r > 0 ? source * squared * s->sigma_t_prime * step * slope
                                       : (quad)INFINITY,
                        .shift = mu * x,
                        .cdf = kappa ? (quad)NAN : step * energy * (1 + mu) / all};
}

/* The integral over u = u_c + ln(1 + e^s); its nodes do not depend on r. */
enum { SINGLE_NODES = 1100, SINGLE_BELOW = 700 };
static struct {
  quad further[SINGLE_NODES], weight[SINGLE_NODES], energy[SINGLE_NODES], sum, least;
} beam;

static void prepare_single(struct subject *s) {
  const quad eta = (quad)s->medium.eta, g = (quad)s->medium.g, step = 0.14Q;
  const quad above = eta > 1 ? eta - 1 + sqrtf128((eta - 1) * (eta + 1)) : 0; /* e^(u_c) - 1 */
  beam.least = 1 + above;
  beam.sum = 0;
  for (int i = 0; i < SINGLE_NODES; i++) {
    const quad e = expf128((i - SINGLE_BELOW) * step);
    const quad E1 = above + beam.least * e, E = 1 + E1, cosh = (E + 1 / E) / 2; /* E = e^u */
    const quad mu = E1 * (2 + E1) / (E * E + 1);
    /* mu^2 - cos_c^2 = sinh(u - u_c) sinh(u + u_c) / (cosh(u) cosh(u_c))^2, and cosh(u_c) = eta */
    const quad sum1 = above * (2 + above) + beam.least * beam.least * e; /* e^(u + u_c) - 1 */
    const quad over = e * (2 + e) / (1 + e) * sum1 * (2 + sum1) / (1 + sum1) / (4 * cosh * cosh);
    const quad outside = sqrtf128(eta > 1 ? over : (1 - eta) * (1 + eta) + eta * eta * mu * mu);
    const quad S = eta * mu + outside, P = eta * outside + mu;
    const quad T = 2 * eta * mu * outside * (1 / (S * S) + 1 / (P * P));
    const quad turned = (1 + g) * (1 + g) - 4 * g / (1 + E * E); /* 1 + g^2 + 2 g mu */
    const quad phase = (1 - g) * (1 + g) / (4 * pi * turned * sqrtf128(turned));
    beam.further[i] = beam.least * e;
    beam.weight[i] = step * e / (1 + e) * phase * T * mu / cosh;
    beam.energy[i] = beam.weight[i] / E;
    beam.sum += beam.energy[i];
  }
  const quad sigma_s = (quad)s->medium.sigma_s_per_mm;
  s->albedo = 2 * pi * sigma_s / (sigma_s + (quad)s->medium.sigma_a_per_mm) * beam.sum;
}

static struct truth single_truth(struct subject *s, double r) {
  const quad sigma_t = (quad)s->medium.sigma_a_per_mm + (quad)s->medium.sigma_s_per_mm;
  const quad tau = sigma_t * (quad)r;
  quad sum = 0, steep = 0, energy = 0;
  for (int i = 0; i < SINGLE_NODES; i++) {
    const quad exponent = tau * beam.further[i];
    if (exponent < 100) {
      const quad left = beam.weight[i] * expf128(-exponent);
      sum += left;
      steep += left * (1 + tau * (beam.further[i] + beam.least));
    }
    energy -= beam.energy[i] * expm1f128(-exponent - tau * beam.least);
  }
  const quad ring = (quad)s->medium.sigma_s_per_mm / (quad)r;
  return (struct truth){.R = r > 0 ? ring * sum : (quad)INFINITY,
                        .slope = r > 0 ? ring / (quad)r * steep : (quad)INFINITY,
                        .shift = tau * beam.least,
                        .cdf = energy / beam.sum};
}

static struct truth burley_truth(struct subject *s, double r) {
  const double given = s->parameters.value[CORE_PARAMETER_SURFACE_ALBEDO];
  quad A = (quad)given;
  if (isnan(given)) {
    reference_dipole_prepare(&dipole, 7, s->moments, &s->medium);
    A = fminf128(to_quad(dipole.albedo), 1);
  }
  const int variant = s->formula->variant;
  const quad away = A - 0.8Q, third = A - 0.33Q;
  const quad ratio = variant == CORE_BURLEY_SEARCHLIGHT
                         ? 1.85Q - A + 7 * fabsf128(away * away * away)
                     : variant == CORE_BURLEY_DIFFUSE ? 1.9Q - A + 3.5Q * away * away
                                                      : 3.5Q + 100 * third * third * third * third;
  const quad mu_tr = s->sigma_t_prime * s->mu;
  const quad d = 1 / (ratio * (variant == CORE_BURLEY_DMFP ? mu_tr : s->sigma_t_prime));
  const quad x = (quad)r / d, fast = expf128(-2 * x / 3);
  const quad R = A * (1 + fast) / (8 * pi * d * (quad)r);
  s->albedo = A;
  return (struct truth){.R = R,
                        .slope = r > 0 ? R / (quad)r +
                                             A * (1 / (quad)3 + fast) / (8 * pi * d * d * (quad)r)
                                       : (quad)INFINITY,
                        .shift = x / 3,
                        .cdf = -(expm1f128(-x) + 3 * expm1f128(-x / 3)) / 4};
}

static struct truth skin_truth(struct subject *s, double r) {
  static const double v[] = {0.0064, 0.0484, 0.187, 0.567, 1.99, 7.41};
  static const double w[][6] = {{0.233, 0.100, 0.118, 0.113, 0.358, 0.078},
                                {0.455, 0.336, 0.198, 0.007, 0.004, 0},
                                {0.649, 0.344, 0, 0.007, 0, 0}};
  static const double widest[] = {7.41, 1.99, 0.567};
  const quad squared = (quad)r * (quad)r;
  struct truth truth = {.shift = squared / (2 * (quad)widest[s->formula->variant])};
  s->albedo = 0;
  for (int i = 0; i < 6; i++) {
    const quad weight = (quad)w[s->formula->variant][i], variance = (quad)v[i];
    const quad part =
        weight > 0 ? weight / (2 * pi * variance) * expf128(truth.shift - squared / (2 * variance))
                   : 0;
    truth.R += part;
    truth.slope += part * (quad)r / variance;
    truth.cdf -= weight * expm1f128(-squared / (2 * variance));
    s->albedo += weight;
  }
  truth.cdf /= s->albedo;
  return truth;
}

/* What leaves a slab at time t, times e^(y^2 / (4 D t)): all images while the cloud is young, else
 * all modes, one by one. */
struct slab {
  quad y, length, wave, rate;
};

static quad leaves_slab(const struct subject *s, const struct slab *slab, quad time) {
  const quad dt = s->diffusion * time, zb = s->two_zb / 2;
  quad sum = 0;
  if (dt < slab->length * slab->length / 10) {
    for (int i = -3; i <= 3; i++) {
      for (int sign = -1; sign <= 1; sign += 2) {
        /* seen from the boundary: images at 2 i L + y and 2 i L - y - 2 z_b */
        const quad q = 2 * i * slab->length + (sign > 0 ? slab->y : -slab->y - 2 * zb);
        const quad g = expf128((slab->y * slab->y - q * q) / (4 * dt)) / sqrtf128(4 * pi * dt);
        sum += sign * g * (s->c_phi + s->c_flux * q / (2 * time));
      }
    }
    return sum;
  }
  for (int n = 1; n <= 13; n++) {
    const quad k = n * slab->wave;
    const quad flux = s->diffusion * k * cosf128(k * zb);
    sum += sinf128(k * (slab->y + zb)) * expf128(slab->y * slab->y / (4 * dt) - dt * k * k) *
           (s->c_phi * sinf128(k * zb) + s->c_flux * flux);
  }
  return 2 / slab->length * sum;
}

/* The integral over time t = t_0 e^u by the trapezoidal rule, around the saddle point t_0 of
 * e^(-rate t - (x^2 + y^2) / (4 D t)). energy: of all radii and within x, else R. */
static void integrate_slab(const struct subject *s, const struct slab *slab, quad x, bool energy,
                           quad sums[2]) {
  const quad rho = hypotf128(energy ? 0 : x, slab->y);
  const quad sharp = rho * sqrtf128(slab->rate / s->diffusion);
  const quad middle = rho / (2 * sqrtf128(slab->rate * s->diffusion));
  const quad step = fminf128(0.18Q, 0.5Q / sqrtf128(sharp));
  const int most = (int)(acoshf128(1 + 90 / sharp) / step) + 1;
  sums[0] = sums[1] = 0;
  for (int i = -most; i <= most; i++) {
    const quad time = middle * expf128(i * step), fourth = 4 * s->diffusion * time;
    const quad alive = expf128(sharp - s->absorbed * time - rho * rho / fourth);
    const quad part = step * time * alive * leaves_slab(s, slab, time) * s->prefactor;
    const quad across = energy ? 1 : part / (pi * fourth);
    sums[0] += energy ? part : across;
    sums[1] += energy ? -part * expm1f128(-x * x / fourth) : across * 2 * x / fourth;
  }
}

static struct truth slab_truth(struct subject *s, double r) {
  const quad thickness = (quad)s->parameters.value[CORE_PARAMETER_THICKNESS] * s->sigma_t_prime;
  struct slab slab = {.length = thickness + s->two_zb};
  slab.y = (s->formula->variant & CORE_SLAB_TRANSMITTED) != 0 ? thickness - 1 : 1;
  slab.wave = pi / slab.length;
  slab.rate = s->absorbed + s->diffusion * slab.wave * slab.wave;
  const quad x = (quad)r * s->sigma_t_prime;
  const quad kappa = sqrtf128(slab.rate / s->diffusion);
  quad energy[2], at[2];
  integrate_slab(s, &slab, x, true, energy);
  s->albedo = energy[0] * expf128(-kappa * slab.y);
  integrate_slab(s, &slab, x, false, at);
  const quad squared = s->sigma_t_prime * s->sigma_t_prime;
  return (struct truth){at[0] * squared, at[1] * squared * s->sigma_t_prime,
                        kappa * hypotf128(x, slab.y), energy[1] / energy[0]};
}

/* A member of the family alone; a sum's truth is that of both parts. */
static struct truth truth_of(struct subject *s, double r) {
  if (isinf(r) || !(s->scattered > 0)) {
    return (struct truth){0, 0, 0, s->scattered > 0};
  }
  switch (s->family) {
  case DIPOLE:
    return dipole_truth(s, r);
  case EXTENDED:
  case QUANTIZED:
    return extended_truth(s, r);
  case SINGLE:
    return single_truth(s, r);
  case BURLEY:
    return burley_truth(s, r);
  case SKIN:
    return skin_truth(s, r);
  case SLAB:
    return slab_truth(s, r);
  default:
    return (struct truth){(quad)NAN, (quad)NAN, 0, (quad)NAN};
  }
}

static void set_subject(struct subject *s, unsigned model) {
  s->formula = formula_of(model);
  s->family = family_of(s->formula);
  s->albedo = (quad)NAN;
  set_table_2(s);
  if (s->family == DIPOLE) {
    reference_dipole_prepare(&dipole, s->formula->variant, s->moments, &s->medium);
    s->albedo = to_quad(dipole.albedo);
  } else if (s->family == SINGLE) {
    prepare_single(s);
  }
}

/* ---- comparing --------------------------------------------------------------------------------- */

enum { QUANTITIES = CORE_ELEMENTWISE_COUNT + 1, ALBEDO = CORE_ELEMENTWISE_COUNT, SHOWN = 3 };

static const struct {
  enum core_quantity quantity;
  const char *name;
} quantities[QUANTITIES] = {
#define CORE_QUANTITY(bit, IDENT, name, unit, SHAPE)                                               \
  CORE_IF_##SHAPE([CORE_ELEMENTWISE_##IDENT] = {CORE_QUANTITY_##IDENT, name}, )
#include "core/choices.def"
    [ALBEDO] = {CORE_QUANTITY_ALBEDO, "albedo"}};

static const unsigned evaluators[EVALUATORS] = {CORE_EVALUATOR_F64, CORE_EVALUATOR_F32,
                                                CORE_EVALUATOR_LUT};
static const char *const evaluator_names[EVALUATORS] = {"f64", "f32", "lut"};

static struct class {
  unsigned long long values, violations;
  double worst; /* error over what was stated */
} classes[MODELS][EVALUATORS][QUANTITIES];

static void compare(const struct subject *s, const core_profile *profile, int evaluator,
                    int quantity, double r, double value, quad truth) {
  const bool wide = evaluator == 0 || quantity == ALBEDO;
  const bool is_ln = quantity == CORE_ELEMENTWISE_LN_R;
  const quad epsilon = wide ? (quad)DBL_EPSILON : (quad)FLT_EPSILON;
  const quad carried = quantity == CORE_ELEMENTWISE_S ? fmaxf128(s->S_per_R, 1) : 1;
  const quad quanta = 16 * carried * (wide ? (quad)DBL_TRUE_MIN : (quad)FLT_TRUE_MIN);
  const quad most = wide ? (quad)DBL_MAX : (quad)FLT_MAX;
  const quad relative =
      (quad)profile->numerical_error +
      (quad)(quantity == ALBEDO || isinf(r) ? 0 : profile->numerical_error_per_mm * r);
  const quad size = fabsf128(truth);
  if (isnan(truth)) {
    return;
  }
  struct class *class = &classes[s->formula - formulas][evaluator][quantity];
  class->values++;
  const quad allowed = is_ln ? relative + 8 * epsilon * size : relative * size;
  const quad error = fabsf128((quad)value - truth);
  const quad R = quantity == CORE_ELEMENTWISE_S && s->S_per_R > 0 ? size / s->S_per_R : size;
  const bool beyond = fmaxf128(size, R) * (1 + relative) > most; /* infinity is right */
  const bool good = isinf(truth) ? (quad)value == truth
                                 : error <= allowed || (!is_ln && error <= quanta) ||
                                       (beyond && isinf(value) && (value > 0) == (truth > 0));
  const double share =
      isinf(truth) || error <= quanta || isinf(value) ? 0 : (double)(error / allowed);
  class->worst = share > class->worst ? share : class->worst;
  if (!good && class->violations++ < SHOWN) {
    const core_medium *m = &s->medium;
    printf("%s %s %s: %.17g, not %.17g: %.3g of %.3g; --sigma-a %.17g --sigma-s %.17g --g %.17g "
           "--eta %.17g --r %.17g (%.3g mfp) moments %d",
           s->formula->name, evaluator_names[evaluator], quantities[quantity].name, value,
           (double)truth, (double)(is_ln ? error : error / size),
           (double)(is_ln ? allowed : relative), m->sigma_a_per_mm, m->sigma_s_per_mm, m->g, m->eta,
           r, r * (double)s->sigma_t_prime, (int)s->moments);
    for (const core_choice *p = core_parameter_list; p->name != NULL; p++) {
      if (!isnan(s->parameters.value[p->id])) {
        printf(" %s %.17g", p->name, s->parameters.value[p->id]);
      }
    }
    printf(" --model %u\n", s->formula->id);
  }
}

static double value_of(const core_profile *profile, enum core_quantity quantity, double r) {
  double value;
  float r_f32 = (float)r, value_f32;
  if (profile->evaluator == CORE_EVALUATOR_F64) {
    core_eval_f64(profile, quantity, 1, &r, &value);
    return value;
  }
  core_eval_f32(profile, quantity, 1, &r_f32, &value_f32);
  return (double)value_f32;
}

/* Where dR/dr, pdf and 2 pi r R keep what is stated. */
static bool is_promised(const struct subject *s, int quantity, double r) {
  const double x = r * (double)s->sigma_t_prime;
  return (quantity != CORE_ELEMENTWISE_SLOPE && quantity != CORE_ELEMENTWISE_PDF &&
          quantity != CORE_ELEMENTWISE_RING) ||
         (s->sigma_t_prime >= 1e-6Q && s->sigma_t_prime <= 1e6Q &&
          s->absorbed <= 1e6Q * s->scattered && s->medium.eta >= 0.2 && s->medium.eta <= 5 &&
          (r == 0 || (x >= 1e-12 && x <= 1e6)));
}

static void compare_all(const struct subject *s, const core_profile *profile, int evaluator,
                        double r, struct truth truth) {
  const quad R = truth.R * expf128(-truth.shift), ring = r > 0 ? 2 * pi * (quad)r * R : (quad)NAN;
  const double far = evaluator == 0 ? 1e100 : 1e12;
  const bool near = r * (double)s->sigma_t_prime < far;
  const quad ln_R =
      s->scattered > 0 && !isinf(r) ? logf128(truth.R) - truth.shift : -(quad)INFINITY;
  const quad truths[QUANTITIES] = {
      [CORE_ELEMENTWISE_R] = R,
      [CORE_ELEMENTWISE_CDF] = s->albedo < 16 * (quad)DBL_TRUE_MIN ? (quad)NAN : truth.cdf,
      [CORE_ELEMENTWISE_SLOPE] = -truth.slope * expf128(-truth.shift),
      [CORE_ELEMENTWISE_LN_R] = near || isinf(ln_R) ? ln_R : (quad)NAN,
      [CORE_ELEMENTWISE_PDF] = s->albedo < 16 * (quad)DBL_TRUE_MIN ? (quad)NAN : ring / s->albedo,
      [CORE_ELEMENTWISE_RING] = ring,
      [CORE_ELEMENTWISE_S] = s->S_per_R > 0 ? R * s->S_per_R : 0,
  };
  for (int q = 0; q < CORE_ELEMENTWISE_COUNT; q++) {
    if (is_promised(s, q, r)) {
      compare(s, profile, evaluator, q, r, value_of(profile, quantities[q].quantity, r), truths[q]);
    }
  }
}

/* Once the cdf is 1 it stays 1. */
static void check_end(const struct subject *s, const core_profile *profile, int evaluator,
                      uint64_t *random) {
  double r = profile->scale_mm * log_between(random, 0.1, 10);
  const double factor = 1 + log_between(random, 1e-6, 0.3);
  double most = 0;
  for (int i = 0; i < 400 && r < 1e30; i++, r *= factor) {
    const double value = value_of(profile, CORE_QUANTITY_CDF, r);
    if (most >= 1 || value > 1) {
      compare(s, profile, evaluator, CORE_ELEMENTWISE_CDF, r, value >= 1 && value <= 1 ? 1 : 2, 1);
    }
    most = value > most ? value : most;
  }
}

/* ---- the campaign ------------------------------------------------------------------------------ */

enum { RADII = 12, ETAS = 48 };

static double etas[ETAS];

static core_medium draw_medium(uint64_t *random) {
  const bool usual = below(random, 3) > 0;
  const double sigma_t = usual ? log_between(random, 1e-2, 1e2) : log_between(random, 1e-14, 1e14);
  const double ratio = usual ? log_between(random, 1e-5, 10) : log_between(random, 1e-30, 1e12);
  const size_t kind = below(random, 8);
  const double g = between(random, -1, 1);
  core_medium medium = {.eta = etas[below(random, usual ? ETAS / 2 : ETAS)]};
  medium.g = kind < 4 ? 0 : usual ? 0.95 * g : kind < 6 ? g : 1 - log_between(random, 1e-12, 1);
  medium.sigma_s_per_mm = fmin(sigma_t / (1 - medium.g) / (1 + ratio), CORE_SIGMA_MAX_PER_MM);
  medium.sigma_a_per_mm = kind == 3 ? 0 : sigma_t * (ratio / (1 + ratio));
  return medium;
}

static core_parameters draw_parameters(const struct subject *s, uint64_t *random, int evaluator) {
  core_parameters parameters = core_parameters_none();
  double *value = parameters.value;
  value[CORE_PARAMETER_COS_IN] = between(random, 0, 1);
  value[CORE_PARAMETER_COS_OUT] = between(random, 0, 1);
  if (s->family == SLAB) {
    const double most = below(random, 2) ? 100 : 0.99e6;
    value[CORE_PARAMETER_THICKNESS] =
        log_between(random, 1.11, most) / core_sigma_t_prime(&s->medium);
  }
  if (s->family == BURLEY && below(random, 2)) {
    value[CORE_PARAMETER_SURFACE_ALBEDO] = between(random, 0, 1);
  }
  if (s->family != FIT && below(random, 2)) {
    value[CORE_PARAMETER_TOLERANCE] =
        evaluator == 2 ? log_between(random, 1e-5, 1e-2) : log_between(random, 1e-12, 0.1);
  }
  return parameters;
}

static double draw_radius(const core_profile *profile, uint64_t *random) {
  static const double ends[][2] = {
      {1e-3, 1e2}, {1e-2, 1e3}, {1e-12, 1e6}, {1e-30, 1e30}, {1e2, 1e4}};
  const size_t kind = below(random, 30);
  const double *range = ends[kind < 12 ? 0 : kind < 18 ? 1 : kind < 22 ? 2 : kind < 24 ? 3 : 4];
  const double r = profile->scale_mm * log_between(random, range[0], range[1]);
  const bool narrow = r < 1e38 && r > 1e-44 && below(random, 8) > 0;
  return kind == 29 ? 0 : kind == 28 ? (double)INFINITY : narrow ? (double)(float)r : r;
}

static core_profile profiles[EVALUATORS];
static core_profile judge; /* of a model without a formula here */

static bool prepare(core_profile *profile, const struct subject *s, unsigned model, int evaluator,
                    const core_parameters *parameters) {
  const core_isa *isa = core_isa_select(NULL);
  return core_profile_prepare(profile, isa, model, s->moments, evaluators[evaluator], &s->medium,
                              parameters)
             .field == NULL;
}

static struct truth judged(double r) {
  const quad R = (quad)value_of(&judge, CORE_QUANTITY_R, r);
  const bool inside = r >= judge.radii.least_mm && r <= judge.radii.most_mm && R > 1e-280Q;
  return (struct truth){inside ? R : (quad)NAN, (quad)NAN, 0, (quad)NAN};
}

/* One subject: evaluators `from` to `to`, of which each profile is there. */
static void compare_subject(struct subject *s, int from, int to, uint64_t *random) {
  struct subject parts[2] = {*s, *s};
  for (int i = 0; s->family == SUM && i < 2; i++) {
    set_subject(&parts[i], s->formula->parts[i]);
  }
  for (int i = 0; i < RADII; i++) {
    const double r = draw_radius(&profiles[from], random);
    struct truth truth;
    if (s->family == SUM) {
      const struct truth a = truth_of(&parts[0], r), b = truth_of(&parts[1], r);
      const quad shift = a.R > 0 && b.R > 0 ? fminf128(a.shift, b.shift)
                         : a.R > 0          ? a.shift
                                            : b.shift;
      const quad left_a = expf128(shift - a.shift), left_b = expf128(shift - b.shift);
      s->albedo = parts[0].albedo + parts[1].albedo;
      truth =
          (struct truth){a.R * left_a + b.R * left_b, a.slope * left_a + b.slope * left_b, shift,
                         (parts[0].albedo * a.cdf + parts[1].albedo * b.cdf) / s->albedo};
    } else {
      truth = s->family == FIT || s->family == TRANSPORT ? judged(r) : truth_of(s, r);
    }
    for (int e = from; e <= to; e++) {
      if (e == 0 || r == (double)(float)r) {
        compare_all(s, &profiles[e], e, r, truth);
        compare(s, &profiles[e], e, ALBEDO, 0, profiles[e].albedo, s->albedo);
      }
    }
  }
  for (int e = from; e <= to; e++) {
    check_end(s, &profiles[e], e, random);
  }
}

/* Draws a subject, f64 and f32 or, once in a while, a table; those that prepare slowly less often. */
static void draw(uint64_t *random, unsigned only) {
  const struct formula *formula = &formulas[below(random, MODELS)];
  const bool table = below(random, 10) == 0;
  struct subject s = {.formula = formula, .family = family_of(formula), .moments = 1};
  s.medium = draw_medium(random);
  const bool slow = s.family == TRANSPORT || s.family == FIT;
  if ((only != 0 && only != formula->id) || (slow && below(random, 100) > 0)) {
    return;
  }
  s.moments = 1 + (unsigned)below(random, 4);
  s.moments =
      core_fresnel_check(s.moments, s.medium.eta).field == NULL ? s.moments : CORE_MOMENTS_EXACT;
  const int from = table ? 2 : 0, to = table ? 2 : 1;
  s.parameters = draw_parameters(&s, random, from);
  int ready = from;
  while (ready <= to && prepare(&profiles[ready], &s, formula->id, ready, &s.parameters)) {
    ready++;
  }
  core_parameters tightest = s.parameters;
  tightest.value[CORE_PARAMETER_TOLERANCE] = s.family == TRANSPORT ? 1e-8 : (double)NAN;
  const unsigned model = s.family == FIT ? CORE_MODEL_BETTER : formula->id;
  const bool judging = slow && ready > to && prepare(&judge, &s, model, 0, &tightest);
  if (ready > to && judging == slow) {
    const double least = profiles[from].radii.least_mm, most = profiles[from].radii.most_mm;
    judge.radii = s.family == TRANSPORT ? (core_radii_range){0, 20 * profiles[from].scale_mm}
                                        : (core_radii_range){least, most};
    const quad eta = (quad)s.medium.eta;
    const reference_fresnel *inverse =
        reference_fresnel_moments(CORE_MOMENTS_EXACT, 1 / s.medium.eta);
    s.S_per_R = transmittance(eta, (quad)s.parameters.value[CORE_PARAMETER_COS_IN]) *
                transmittance(eta, (quad)s.parameters.value[CORE_PARAMETER_COS_OUT]) /
                (pi * to_quad(inverse->one_minus_2c1));
    set_subject(&s, formula->id);
    compare_subject(&s, from, to, random);
  }
  for (int e = from; e < ready; e++) {
    core_profile_free(&profiles[e]);
  }
  if (judging) {
    core_profile_free(&judge);
  }
}

static unsigned long long print_classes(void) {
  unsigned long long values = 0, violations = 0;
  printf("%-30s %-4s %-9s %12s %7s %s\n", "model", "", "", "values", "worst", "violations");
  for (const struct class *class = &classes[0][0][0];
       class < &classes[0][0][0] + sizeof classes / sizeof *class; class ++) {
    const size_t at = (size_t)(class - &classes[0][0][0]);
    if (class->values > 0) {
      printf("%-30s %-4s %-9s %12llu %7.3f %llu\n",
             core_choice_by_id(core_models, formulas[at / (EVALUATORS * QUANTITIES)].id)->name,
             evaluator_names[at / QUANTITIES % EVALUATORS], quantities[at % QUANTITIES].name,
             class->values, class->worst, class->violations);
    }
    values += class->values;
    violations += class->violations;
  }
  printf("%llu values, %llu off by more than stated\n", values, violations);
  return violations;
}

static double now_s(void) {
  struct timespec now;
  timespec_get(&now, TIME_UTC);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

int main(int count, char **arguments) {
  const double start_s = now_s();
  const double seconds = count > 1 ? atof(arguments[1]) : 60;
  uint64_t random = count > 2 ? strtoull(arguments[2], NULL, 0) : (uint64_t)(start_s * 1e6);
  const unsigned only = count > 3 ? (unsigned)atoi(arguments[3]) : 0;
  printf("seed %llu\n", (unsigned long long)random);
  reference_dipole_init(&dipole);
  reference_values_init(&dipole_values);
  for (int i = 0; i < ETAS; i++) {
    etas[i] = i == 0         ? 1
              : i < ETAS / 2 ? 1 + 0.02 * (double)below(&random, 60)
                             : log_between(&random, CORE_ETA_MIN, CORE_ETA_MAX);
  }
  while (now_s() - start_s < seconds) {
    draw(&random, only);
  }
  return print_classes() > 0;
}
