#include "tests/accuracy/forms.h"

#include <assert.h>
#include <float.h>
#include <math.h>
#include <string.h>

static const quad pi = 3.14159265358979323846264338327950288Q;

static const struct formula {
  unsigned id;
  const char *name;
  int variant;
  unsigned parts[2]; /* of a sum */
} formulas[] = {
#define MODEL(id, IDENT, name, formula, kernels, variant, ...) {id, #formula, variant, {0}},
#define SUM(id, IDENT, name, FIRST, SECOND, source)                                                \
  {id, "sum", 0, {CORE_MODEL_##FIRST, CORE_MODEL_##SECOND}},
    CORE_EACH_MODEL(MODEL, SUM)};

static const struct formula *formula_of(unsigned model) {
  size_t i = 0;
  while (formulas[i].id != model) {
    i++;
  }
  return &formulas[i];
}

enum form_family form_family_of(unsigned model) {
  static const char *const names[] = {"dipole",    "extended",  "",      "single",
                                      "burley",    "gaussians", "cloud", "gaussian_fit",
                                      "transport", "sum"};
  if (model == CORE_MODEL_QUANTIZED) {
    return FORM_QUANTIZED;
  }
  for (enum form_family f = FORM_DIPOLE;; f++) {
    assert(f < sizeof names / sizeof names[0]);
    if (strcmp(formula_of(model)->name, names[f]) == 0) {
      return f;
    }
  }
}

/* Returns Fresnel's transmittance from outside, unpolarized. */
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

/* Sets the coefficients of d'Eon 2012, Table 2, in mean free paths. */
static void set_table_2(form_part *p, enum core_moments moments) {
  const core_medium *m = &p->medium;
  const bool chosen = p->family == FORM_SLAB || p->family == FORM_DIPOLE;
  const int switches = chosen ? p->variant : 7;
  const reference_fresnel fresnel = reference_fresnel_moments(moments, m->eta);
  const quad lost1 = fresnel.one_minus_2c1, lost2 = fresnel.one_minus_3c2;
  const quad sigma_s_prime = (quad)m->sigma_s_per_mm * (1 - (quad)m->g);
  p->sigma_t_prime = (quad)m->sigma_a_per_mm + sigma_s_prime;
  p->absorbed = (quad)m->sigma_a_per_mm / p->sigma_t_prime;
  p->scattered = sigma_s_prime / p->sigma_t_prime;
  p->diffusion = (switches & CORE_DIPOLE_GROSJEAN) != 0 ? (1 + p->absorbed) / 3 : (quad)1 / 3;
  p->prefactor =
      (switches & CORE_DIPOLE_GROSJEAN) != 0 ? p->scattered * p->scattered : p->scattered;
  p->mu = sqrtf128(p->absorbed / p->diffusion);
  const quad lost = (switches & CORE_DIPOLE_BOUNDARY) != 0 ? lost2 : lost1;
  p->two_zb = 4 * (2 - lost) / lost1 * p->diffusion;
  p->c_phi = (switches & CORE_DIPOLE_EXITANCE) != 0 ? lost1 / 4 : 0;
  p->c_flux = (switches & CORE_DIPOLE_EXITANCE) != 0 ? lost2 / 2 : 1;
}

/* ---- a source at one depth, and at all depths --------------------------------------------------- */

#define REAL quad
#define EXP expf128
#define EXPM1 expm1f128
#define SQRT sqrtf128
#define NAME(x) x##_113
#include "tests/accuracy/forms_sums.h"

#define REAL long double
#define EXP expl
#define EXPM1 expm1l
#define SQRT sqrtl
#define NAME(x) x##_64
#include "tests/accuracy/forms_sums.h"

/* Returns the whole energy of the dipole at a depth, divided by e^(-mu z). */
static quad energy_at_depth(const form_part *p) {
  const quad share = p->mu > 0 ? -expm1f128(-p->mu * p->two_zb) : 0;
  const quad spread = p->mu > 0 ? share / p->mu : p->two_zb;
  return p->c_flux * (2 - share) + p->c_phi / p->diffusion * spread;
}

static form_values dipole_at(const form_part *p, quad x) {
  const struct table_2_113 table = table_2_of_113(p);
  const struct depths_113 at = at_depth_113(&table, x, 1);
  const quad source = p->prefactor / (4 * pi) * p->sigma_t_prime * p->sigma_t_prime;
  return (form_values){source * at.R, source * p->sigma_t_prime * at.slope, p->mu * x,
                       at.energy / energy_at_depth(p)};
}

static struct depths_113 widened(struct depths_64 at) {
  return (struct depths_113){(quad)at.R, (quad)at.slope, (quad)at.energy};
}

static form_values extended_at(const form_part *p, quad x, bool fast) {
  if (x <= 0) {
    return (form_values){(quad)INFINITY, (quad)INFINITY, 0, 0};
  }
  const struct depths_113 sum =
      fast ? widened(at_all_depths_64(p, (long double)x)) : at_all_depths_113(p, x);
  const quad source = p->prefactor / (4 * pi) * p->sigma_t_prime * p->sigma_t_prime;
  const bool beam = p->family == FORM_EXTENDED && p->variant == 1;
  return (form_values){source * sum.R, source * p->sigma_t_prime * sum.slope, p->mu * x,
                       beam ? (quad)NAN : sum.energy * (1 + p->mu) / energy_at_depth(p)};
}

/* ---- single scattering ------------------------------------------------------------------------- */

/* The integral over u = u_c + ln(1 + e^s) by the trapezoidal rule; its nodes do not depend on r. */
#define SINGLE_STEP 0.24Q
enum { SINGLE_BELOW = 400 };

static void prepare_single(form_part *p) {
  const quad eta = (quad)p->medium.eta, g = (quad)p->medium.g;
  /* e^(u_c) - 1 */
  const quad above = eta > 1 ? eta - 1 + sqrtf128((eta - 1) * (eta + 1)) : 0;
  quad before = 0;
  p->least = 1 + above;
  p->sum = 0;
  for (int i = 0; i < FORM_SINGLE_NODES; i++) {
    const quad e = expf128((i - SINGLE_BELOW) * SINGLE_STEP);
    const quad E1 = above + p->least * e, E = 1 + E1, cosh = (E + 1 / E) / 2; /* E = e^u */
    const quad mu = E1 * (2 + E1) / (E * E + 1);
    /* mu^2 - cos_c^2 = sinh(u - u_c) sinh(u + u_c) / (cosh(u) cosh(u_c))^2, and cosh(u_c) = eta */
    const quad sum1 = above * (2 + above) + p->least * p->least * e; /* e^(u + u_c) - 1 */
    const quad over = e * (2 + e) / (1 + e) * sum1 * (2 + sum1) / (1 + sum1) / (4 * cosh * cosh);
    const quad outside = sqrtf128(eta > 1 ? over : (1 - eta) * (1 + eta) + eta * eta * mu * mu);
    const quad S = eta * mu + outside, P = eta * outside + mu;
    const quad T = 2 * eta * mu * outside * (1 / (S * S) + 1 / (P * P));
    const quad turned = (1 + g) * (1 + g) - 4 * g / (1 + E * E); /* 1 + g^2 + 2 g mu */
    const quad phase = (1 - g) * (1 + g) / (4 * pi * turned * sqrtf128(turned));
    p->further[i] = p->least * e;
    p->weight[i] = SINGLE_STEP * e / (1 + e) * phase * T * mu / cosh;
    p->energy[i] = p->weight[i] / E;
    p->weight_before[i] = before;
    before += p->weight[i];
    p->sum += p->energy[i];
  }
  const quad sigma_s = (quad)p->medium.sigma_s_per_mm;
  p->albedo = 2 * pi * sigma_s / (sigma_s + (quad)p->medium.sigma_a_per_mm) * p->sum;
}

static form_values single_at(const form_part *p, double r, bool fast) {
  if (!(r > 0)) {
    return (form_values){(quad)INFINITY, (quad)INFINITY, 0, 0};
  }
  const quad sigma_t = (quad)p->medium.sigma_a_per_mm + (quad)p->medium.sigma_s_per_mm;
  const quad tau = sigma_t * (quad)r, ring = (quad)p->medium.sigma_s_per_mm / (quad)r;
  const struct depths_113 sum =
      fast ? widened(at_all_angles_64(p, (long double)tau)) : at_all_angles_113(p, tau);
  return (form_values){ring * sum.R, ring / (quad)r * sum.slope, tau * p->least,
                       sum.energy / p->sum};
}

/* ---- Burley's profile and skin ------------------------------------------------------------------ */

/* Unless the albedo is given, it is that of the better dipole, whose coefficients set_table_2() has
 * set. */
static void prepare_burley(form_part *p, double given) {
  const quad better = p->prefactor / 2 * energy_at_depth(p) * expf128(-p->mu);
  const quad A = isnan(given) ? fminf128(better, 1) : (quad)given;
  const quad away = A - 0.8Q, third = A - 0.33Q;
  const quad ratio =
      p->variant == CORE_BURLEY_SEARCHLIGHT ? 1.85Q - A + 7 * fabsf128(away * away * away)
      : p->variant == CORE_BURLEY_DIFFUSE   ? 1.9Q - A + 3.5Q * away * away
                                            : 3.5Q + 100 * third * third * third * third;
  p->per_d = ratio * (p->variant == CORE_BURLEY_DMFP ? p->sigma_t_prime * p->mu : p->sigma_t_prime);
  p->albedo = A;
}

static form_values burley_at(const form_part *p, double r) {
  const quad x = (quad)r * p->per_d, fast = expf128(-2 * x / 3);
  const quad per_8_pi_d = p->albedo * p->per_d / (8 * pi), R = per_8_pi_d * (1 + fast) / (quad)r;
  const quad steeper = per_8_pi_d * p->per_d * (1 / (quad)3 + fast) / (quad)r;
  return (form_values){.R = R,
                       .slope = r > 0 ? R / (quad)r + steeper : (quad)INFINITY,
                       .shift = x / 3,
                       .cdf = -(expm1f128(-x) + 3 * expm1f128(-x / 3)) / 4};
}

/* d'Eon and Luebke 2007: variances in mm^2, and weights for red, green and blue. */
static const double skin_variance[] = {0.0064, 0.0484, 0.187, 0.567, 1.99, 7.41};
static const double skin_weight[][6] = {{0.233, 0.100, 0.118, 0.113, 0.358, 0.078},
                                        {0.455, 0.336, 0.198, 0.007, 0.004, 0},
                                        {0.649, 0.344, 0, 0.007, 0, 0}};

static form_values skin_at(const form_part *p, double r) {
  static const double widest[] = {7.41, 1.99, 0.567};
  const quad squared = (quad)r * (quad)r;
  form_values at = {.shift = squared / (2 * (quad)widest[p->variant])};
  for (int i = 0; i < 6; i++) {
    const quad weight = (quad)skin_weight[p->variant][i], variance = (quad)skin_variance[i];
    const quad exponent = squared / (2 * variance);
    const quad part = weight > 0 ? weight / (2 * pi * variance) * expf128(at.shift - exponent) : 0;
    at.R += part;
    at.slope += part * (quad)r / variance;
    at.cdf -= weight * expm1f128(-exponent);
  }
  at.cdf /= p->albedo;
  return at;
}

/* ---- slabs ------------------------------------------------------------------------------------- */

/* Returns what leaves a slab at a time, times e^(y^2 / (4 D t) + D (pi / L)^2 t): all images while
 * the cloud is young, else all modes, one by one. A term that is less than e^-100 of the others is
 * left out. */
static quad leaves_slab(const form_part *p, quad time) {
  const quad dt = p->diffusion * time, wave = pi / p->length;
  quad sum = 0;
  if (dt < p->length * p->length / 10) {
    const quad per_root = 1 / sqrtf128(4 * pi * dt);
    for (int i = -3; i <= 3; i++) {
      for (int sign = -1; sign <= 1; sign += 2) {
        /* seen from the boundary: images at 2 i L + y and 2 i L - y - 2 z_b */
        const quad q = 2 * i * p->length + (sign > 0 ? p->y : -p->y - p->two_zb);
        const quad exponent = (p->y - q) * (p->y + q) / (4 * dt);
        sum += exponent > -100 ? sign * expf128(exponent) * (p->c_phi + p->c_flux * q / (2 * time))
                               : 0;
      }
    }
    return sum * per_root * expf128(dt * wave * wave);
  }
  const quad risen = p->y * p->y / (4 * dt);
  for (int n = 1; n <= FORM_MODES; n++) {
    const quad faster = dt * wave * wave * (n * n - 1);
    if (faster < 100) {
      sum += p->mode_source[n - 1] * expf128(risen - faster) *
             (p->c_phi * p->mode_sine[n - 1] + p->c_flux * p->mode_flux[n - 1]);
    }
  }
  return 2 / p->length * sum;
}

/* The nodes of the integral over time t = t_0 e^u by the trapezoidal rule, around the saddle point
 * t_0 of e^(-rate t - rho^2 / (4 D t)). */
struct saddle {
  quad rho, sharp, middle, step;
  int most;
};

static struct saddle saddle_at(const form_part *p, quad x) {
  struct saddle s = {.rho = sqrtf128(x * x + p->y * p->y)};
  s.sharp = s.rho * sqrtf128(p->rate / p->diffusion);
  s.middle = s.rho / (2 * sqrtf128(p->rate * p->diffusion));
  s.step = fminf128(0.2Q, 0.5Q / sqrtf128(s.sharp));
  s.most = (int)(acoshf128(1 + 60 / s.sharp) / s.step) + 1;
  return s;
}

/* Returns the light that leaves around node i, times e^sharp. *fourth: 4 D t. */
static quad leaving_at(const form_part *p, const struct saddle *s, int i, quad *fourth) {
  const quad u = i * s->step, time = s->middle * expf128(u), sinh = sinhf128(u / 2);
  *fourth = 4 * p->diffusion * time;
  /* sharp - rate t - rho^2 / (4 D t) = sharp (1 - cosh u) */
  const quad alive = expf128(-2 * s->sharp * sinh * sinh);
  return s->step * time * alive * leaves_slab(p, time) * p->prefactor;
}

static void prepare_slab(form_part *p, double thickness_mm) {
  const quad thickness = (quad)thickness_mm * p->sigma_t_prime, zb = p->two_zb / 2;
  p->length = thickness + p->two_zb;
  p->y = (p->variant & CORE_SLAB_TRANSMITTED) != 0 ? thickness - 1 : 1;
  const quad wave = pi / p->length;
  p->rate = p->absorbed + p->diffusion * wave * wave;
  for (int n = 1; n <= FORM_MODES; n++) {
    p->mode_source[n - 1] = sinf128(n * wave * (p->y + zb));
    p->mode_sine[n - 1] = sinf128(n * wave * zb);
    p->mode_flux[n - 1] = p->diffusion * n * wave * cosf128(n * wave * zb);
  }
  const struct saddle saddle = saddle_at(p, 0);
  p->slab_nodes = (size_t)(2 * saddle.most + 1);
  assert(p->slab_nodes <= FORM_SLAB_NODES);
  p->leaving = 0;
  for (size_t i = 0; i < p->slab_nodes; i++) {
    quad fourth;
    p->left[i] = leaving_at(p, &saddle, (int)i - saddle.most, &fourth);
    p->per_fourth[i] = 1 / fourth;
    p->leaving += p->left[i];
  }
  p->albedo = p->leaving * expf128(-saddle.sharp);
}

static form_values slab_at(const form_part *p, quad x) {
  const struct saddle saddle = saddle_at(p, x);
  const quad squared = p->sigma_t_prime * p->sigma_t_prime;
  form_values at = {.shift = saddle.sharp};
  for (int i = -saddle.most; i <= saddle.most; i++) {
    quad fourth;
    const quad across = leaving_at(p, &saddle, i, &fourth) / (pi * fourth) * squared;
    at.R += across;
    at.slope += across * 2 * x / fourth * p->sigma_t_prime;
  }
  for (size_t i = 0; i < p->slab_nodes; i++) {
    const quad exponent = x * x * p->per_fourth[i];
    at.cdf -= p->left[i] * (exponent < 90 ? expm1f128(-exponent) : -1);
  }
  at.cdf /= p->leaving;
  return at;
}

/* ---- any model ---------------------------------------------------------------------------------- */

static void prepare_part(form_part *p, const struct formula *formula, enum core_moments moments,
                         const core_medium *medium, const core_parameters *parameters) {
  p->family = form_family_of(formula->id);
  p->variant = formula->variant;
  p->medium = *medium;
  p->albedo = (quad)NAN;
  set_table_2(p, moments);
  switch (p->family) {
  case FORM_DIPOLE:
    p->albedo = p->prefactor / 2 * energy_at_depth(p) * expf128(-p->mu);
    break;
  case FORM_EXTENDED:
  case FORM_QUANTIZED:
    if (p->variant != 1 || p->family == FORM_QUANTIZED) {
      p->albedo = p->prefactor / 2 * energy_at_depth(p) / (1 + p->mu);
    }
    break;
  case FORM_SINGLE:
    prepare_single(p);
    break;
  case FORM_BURLEY:
    prepare_burley(p, parameters->value[CORE_PARAMETER_SURFACE_ALBEDO]);
    break;
  case FORM_SKIN:
    p->albedo = 0;
    for (int i = 0; i < 6; i++) {
      p->albedo += (quad)skin_weight[p->variant][i];
    }
    break;
  case FORM_SLAB:
    prepare_slab(p, medium->thickness_mm);
    break;
  default:
    break;
  }
}

void form_prepare(form_model *form, unsigned model, enum core_moments moments,
                  const core_medium *medium, const core_parameters *parameters) {
  const struct formula *formula = formula_of(model);
  const enum form_family family = form_family_of(model);
  form->parts = family == FORM_SUM ? 2 : 1;
  form->known = family != FORM_FIT && family != FORM_TRANSPORT;
  form->albedo = 0;
  for (size_t i = 0; i < form->parts; i++) {
    prepare_part(&form->part[i], family == FORM_SUM ? formula_of(formula->parts[i]) : formula,
                 moments, medium, parameters);
    form->albedo += form->part[i].albedo;
  }
  const quad eta = (quad)medium->eta;
  form->S_per_R =
      transmittance(eta, (quad)parameters->value[CORE_PARAMETER_COS_IN]) *
      transmittance(eta, (quad)parameters->value[CORE_PARAMETER_COS_OUT]) /
      (pi * reference_fresnel_moments(CORE_MOMENTS_EXACT, 1 / medium->eta).one_minus_2c1);
}

static form_values part_at(const form_part *p, double r, bool fast) {
  const bool gives =
      p->family == FORM_SKIN || p->family == FORM_BURLEY ? p->albedo > 0 : p->scattered > 0;
  if (isinf(r) || !gives) {
    return (form_values){0, 0, 0, gives};
  }
  const quad x = (quad)r * p->sigma_t_prime;
  switch (p->family) {
  case FORM_DIPOLE:
    return dipole_at(p, x);
  case FORM_EXTENDED:
  case FORM_QUANTIZED:
    return extended_at(p, x, fast);
  case FORM_SINGLE:
    return single_at(p, r, fast);
  case FORM_BURLEY:
    return burley_at(p, r);
  case FORM_SKIN:
    return skin_at(p, r);
  case FORM_SLAB:
    return slab_at(p, x);
  default:
    return (form_values){(quad)NAN, (quad)NAN, 0, (quad)NAN};
  }
}

form_values form_at(const form_model *form, double r, bool fast) {
  const form_values a = part_at(&form->part[0], r, fast);
  if (form->parts == 1) {
    return a;
  }
  const form_values b = part_at(&form->part[1], r, fast);
  const quad shift = a.R > 0 && b.R > 0 ? fminf128(a.shift, b.shift) : a.R > 0 ? a.shift : b.shift;
  const quad left_a = expf128(shift - a.shift), left_b = expf128(shift - b.shift);
  return (form_values){
      a.R > 0 ? a.R * left_a + (b.R > 0 ? b.R * left_b : 0) : b.R * left_b,
      a.slope > 0 ? a.slope * left_a + (b.slope > 0 ? b.slope * left_b : 0) : b.slope * left_b,
      shift, (form->part[0].albedo * a.cdf + form->part[1].albedo * b.cdf) / form->albedo};
}

/* Returns the Hankel transform of R of a part. A wave of light spreads from its depth as light does
 * that is absorbed more: mu^2 + k^2 stands for mu^2 in the energy. NAN if it is not known. */
static quad part_transfer(const form_part *p, double f) {
  const bool gives = p->albedo > 0;
  if (isinf(f) || !gives) {
    return gives || p->albedo <= 0 ? 0 : (quad)NAN;
  }
  const quad k = 2 * pi * (quad)f, scaled = k / p->sigma_t_prime;
  form_part wave = {.mu = sqrtf128(p->mu * p->mu + scaled * scaled),
                    .two_zb = p->two_zb,
                    .c_phi = p->c_phi,
                    .c_flux = p->c_flux,
                    .diffusion = p->diffusion};
  quad sum = 0;
  switch (p->family) {
  case FORM_DIPOLE:
    return p->prefactor / 2 * energy_at_depth(&wave) * expf128(-wave.mu);
  case FORM_EXTENDED:
  case FORM_QUANTIZED:
    return p->prefactor / 2 * energy_at_depth(&wave) / (1 + wave.mu);
  case FORM_SINGLE: /* that of e^(-s r) / r is 2 pi / sqrt(s^2 + k^2) */
    for (int i = 0; i < FORM_SINGLE_NODES; i++) {
      const quad sigma_t = (quad)p->medium.sigma_a_per_mm + (quad)p->medium.sigma_s_per_mm;
      const quad s = sigma_t * (p->least + p->further[i]);
      sum += p->weight[i] / sqrtf128(s * s + k * k);
    }
    return 2 * pi * (quad)p->medium.sigma_s_per_mm * sum;
  case FORM_BURLEY: {
    const quad kd = k / p->per_d;
    return p->albedo / 4 * (1 / sqrtf128(1 + kd * kd) + 3 / sqrtf128(1 + 9 * kd * kd));
  }
  case FORM_SKIN:
    for (int i = 0; i < 6; i++) {
      const quad exponent = k * k * (quad)skin_variance[i] / 2;
      sum += (quad)skin_weight[p->variant][i] * expf128(-exponent);
    }
    return sum;
  case FORM_SLAB:
    for (size_t i = 0; i < p->slab_nodes; i++) {
      sum += p->left[i] * expf128(-scaled * scaled / (4 * p->per_fourth[i]));
    }
    return p->albedo * (sum / p->leaving);
  default:
    return (quad)NAN;
  }
}

static quad transfer(const form_model *form, double f) {
  const quad first = part_transfer(&form->part[0], f);
  return form->parts == 1 ? first : first + part_transfer(&form->part[1], f);
}

/* ---- comparing --------------------------------------------------------------------------------- */

quad form_truth(const form_model *form, form_values at, enum core_elementwise quantity, double r) {
  const quad R = at.R * expf128(-at.shift), ring = r > 0 ? 2 * pi * (quad)r * R : (quad)NAN;
  const bool dark = form->albedo < 16 * (quad)DBL_TRUE_MIN;
  switch (quantity) {
  case CORE_ELEMENTWISE_R:
    return R;
  case CORE_ELEMENTWISE_CDF:
    return dark ? (quad)NAN : at.cdf;
  case CORE_ELEMENTWISE_SLOPE:
    return -at.slope * expf128(-at.shift);
  case CORE_ELEMENTWISE_LN_R:
    return at.R > 0 ? logf128(at.R) - at.shift : -(quad)INFINITY;
  case CORE_ELEMENTWISE_PDF:
    return dark ? (quad)NAN : ring / form->albedo;
  case CORE_ELEMENTWISE_RING:
    return ring;
  case CORE_ELEMENTWISE_TRANSFER:
    return form->known ? transfer(form, r) : (quad)NAN;
  case CORE_ELEMENTWISE_T: /* of half spaces */
    return form->part[0].medium.thickness_mm > 0 ? (quad)NAN : 0;
  case CORE_ELEMENTWISE_BY_SIGMA_A: /* form_path() */
  case CORE_ELEMENTWISE_BY_SIGMA_S:
    return (quad)NAN;
  default:
    return form->S_per_R > 0 ? R * form->S_per_R : 0;
  }
}

bool form_promises(const form_model *form, int quantity, double r) {
  const form_part *part = &form->part[0];
  const double x = r * (double)part->sigma_t_prime;
  return quantity != CORE_ELEMENTWISE_SLOPE ||
         (part->sigma_t_prime >= 1e-6Q && part->sigma_t_prime <= 1e6Q &&
          part->absorbed <= 1e6Q * part->scattered && part->medium.eta >= 0.2 &&
          part->medium.eta <= 5 && (!(r > 0) || (x >= 1e-12 && x <= 1e6)));
}

static bool is_wide(const core_profile *profile, int quantity) {
  return profile->evaluator == CORE_EVALUATOR_F64 || quantity == FORM_ALBEDO;
}

/* ln R is a power series in u = sqrt(sigma_a), whose term in u is 0, as a path is finite at sigma_a = 0;
 * Burley's profiles may have ln u. Its derivatives at u[0] are those of Newton's polynomial through
 * values at the next u. */
quad form_path(unsigned model, enum core_moments moments, const core_medium *medium,
               const core_parameters *parameters, double r, quad *unsure) {
  enum { NODES = 9 };
  static form_model form;
  quad u[NODES], by[NODES], path = 0;
  core_medium other = *medium;
  const double sigma_s_prime = medium->sigma_s_per_mm * (1 - medium->g);
  const bool burley = form_family_of(model) == FORM_BURLEY;
  const double start = sqrt(medium->sigma_a_per_mm), scale = sqrt(sigma_s_prime) + start;
  const double step = 0x1p-12 * (burley ? start : scale) / (1 + r * scale * scale);
  for (int i = 0; i < NODES; i++) {
    other.sigma_a_per_mm = i == 0 ? medium->sigma_a_per_mm : pow(start + i * step, 2);
    u[i] = sqrtf128((quad)other.sigma_a_per_mm);
    form_prepare(&form, model, moments, &other, parameters);
    by[i] = form_truth(&form, form_at(&form, r, false), CORE_ELEMENTWISE_LN_R, r);
  }
  for (int k = 1; k < NODES; k++) {
    for (int i = NODES - 1; i >= k; i--) {
      by[i] = (by[i] - by[i - 1]) / (u[i] - u[i - k]);
    }
  }
  for (int last = NODES - 2; last < NODES; last++) { /* without the last value, and with it */
    quad term[4] = {by[last], 0, 0, 0};              /* of the Taylor series at u[0] */
    for (int k = last - 1; k >= 0; k--) {
      for (int i = 3; i > 0; i--) {
        term[i] = term[i] * (u[0] - u[k]) + term[i - 1];
      }
      term[0] = term[0] * (u[0] - u[k]) + by[k];
    }
    const quad before = path; /* near 0 the quotient is that of the series */
    path = burley || start > 1e-5 * step ? -term[1] / (2 * u[0]) : 1.5Q * term[3] * u[0] - term[2];
    *unsure = fabsf128(path - before) + 1e-16Q * fabsf128(path);
  }
  return path;
}

quad form_allowed(const core_profile *profile, int quantity, double r, quad size) {
  const quad epsilon = is_wide(profile, quantity) ? (quad)DBL_EPSILON : (quad)FLT_EPSILON;
  const quad per_mm = (quad)profile->numerical_error_per_mm;
  const double slope = quantity == CORE_ELEMENTWISE_SLOPE ? profile->slope_error : 0;
  if (quantity == CORE_ELEMENTWISE_TRANSFER) {
    return ((quad)profile->numerical_error + (quad)CORE_TRANSFER_ERROR) * (quad)profile->albedo;
  }
  const quad relative = (quad)fmax(profile->numerical_error, slope) +
                        (quantity == CORE_ELEMENTWISE_S ? (quad)CORE_S_ERROR : 0) +
                        (quantity == FORM_ALBEDO || isinf(r) ? 0 : per_mm * (quad)r);
  return quantity == CORE_ELEMENTWISE_LN_R ? relative + 8 * epsilon * size : relative * size;
}

/* Returns a value over R, for quantities that are R times a number; else 1. */
static quad multiple_of_R(const form_model *form, int quantity, double r) {
  return quantity == CORE_ELEMENTWISE_S      ? form->S_per_R
         : quantity == CORE_ELEMENTWISE_RING ? 2 * pi * (quad)r
         : quantity == CORE_ELEMENTWISE_PDF  ? 2 * pi * (quad)r / form->albedo
                                             : 1;
}

double form_share(const form_model *form, const core_profile *profile, int quantity, double r,
                  double value, quad truth, quad unsure) {
  const bool wide = is_wide(profile, quantity);
  const quad size = fabsf128(truth), error = fabsf128((quad)value - truth);
  const quad allowed = form_allowed(profile, quantity, r, size) + unsure;
  const quad times = multiple_of_R(form, quantity, r);
  const quad carried = fmaxf128(times, 1);
  const quad quanta = 16 * carried * (wide ? (quad)DBL_TRUE_MIN : (quad)FLT_TRUE_MIN);
  const quad R = times > 0 ? size / times : size;
  const quad most = wide ? (quad)DBL_MAX : (quad)FLT_MAX;
  const bool overflows = fmaxf128(size, R) + allowed > most;
  if (isinf(truth) || isinf(value)) {
    const bool right = (quad)value == truth || (overflows && isinf(value) && value * truth > 0);
    return right ? 0 : (double)INFINITY;
  }
  return quantity != CORE_ELEMENTWISE_LN_R && error <= quanta ? 0 : (double)(error / allowed);
}
