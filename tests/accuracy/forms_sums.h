/* forms_sums: the sums of tests/accuracy/forms.c that take long. It includes this file twice, with
 * the number type REAL (`quad` or long double), its functions EXP, EXPM1 and SQRT, and NAME(x), the
 * name of x for that type. */

/* Sums over depths: of R, -dR/dx and the energy within x, without their common factors. */
struct NAME(depths) {
  REAL R, slope, energy;
};

/* Coefficients of Table 2: `phi` is C_phi / D. */
struct NAME(table_2) {
  REAL mu, phi, two_zb, c_flux;
  bool kappa; /* whether the model is `beam` */
};

static struct NAME(table_2) NAME(table_2_of)(const form_part *p) {
  return (struct NAME(table_2)){(REAL)p->mu, (REAL)(p->c_phi / p->diffusion), (REAL)p->two_zb,
                                (REAL)p->c_flux, p->family == FORM_EXTENDED && p->variant == 1};
}

/* Returns the light of the dipole at depth z at the radius x, times e^(mu x): Table 2 with
 * differences written as products. */
static struct NAME(depths) NAME(at_depth)(const struct NAME(table_2) * p, REAL x, REAL z) {
  const REAL mu = p->mu, two_zb = p->two_zb, z2 = z + two_zb, squared = x * x;
  const REAL d1 = SQRT(squared + z * z), d2 = SQRT(squared + z2 * z2);
  const REAL i1 = 1 / d1, i2 = 1 / d2;
  const REAL apart = two_zb * (z + z2) / (d1 + d2); /* d2 - d1 */
  const REAL lost = mu > 0 ? -EXPM1(-mu * apart) : 0;
  const REAL e1 = mu > 0 ? EXP(-mu * (z * z / (d1 + x))) : 1, e2 = e1 * (1 - lost);
  const REAL g1 = e1 * i1 * i1 * (mu + i1), g2 = e2 * i2 * i2 * (mu + i2);
  const REAL h1 = e1 * i1 * i1 * i1 * (mu * mu + 3 * mu * i1 + 3 * i1 * i1);
  const REAL h2 = e2 * i2 * i2 * i2 * (mu * mu + 3 * mu * i2 + 3 * i2 * i2);
  const REAL fluence = e1 * i1 * i2 * (apart + d1 * lost);
  const REAL squares = apart * i1 * i2 * (i1 + i2);
  const REAL steeper = e1 * (mu * squares + apart * i1 * i2 * (i1 * i1 + i1 * i2 + i2 * i2) +
                             (mu * i2 * i2 + i2 * i2 * i2) * lost);
  const REAL braces = p->phi * fluence + p->c_flux * (z * g1 + z2 * g2);
  const REAL steep = x * (p->phi * steeper + p->c_flux * (z * h1 + z2 * h2));
  if (p->kappa) {
    const REAL factor = -EXPM1(-2 * (d1 + z));
    return (struct NAME(depths)){factor * braces,
                                 factor * steep - 2 * x * i1 * (1 - factor) * braces, 0};
  }
  const REAL a1 = squared / (d1 + z), a2 = squared / (d2 + z2); /* d - z */
  const REAL share = mu > 0 ? -EXPM1(-mu * two_zb) : 0, mirrored = 1 - share;
  const REAL spread = mu > 0 ? share / mu : two_zb;
  const REAL gone1 = mu > 0 ? -EXPM1(-mu * a1) : 0, gone2 = mu > 0 ? -EXPM1(-mu * a2) : 0;
  const REAL flux = (a1 + z * gone1) * i1 + mirrored * (a2 + z2 * gone2) * i2;
  const REAL left = (1 - gone1) * (mu > 0 ? lost / mu : apart);
  const REAL near = mu > 0 ? (gone1 - mirrored * gone2) / mu : a1 - a2;
  return (struct NAME(depths)){braces, steep,
                               p->c_flux * flux + p->phi * (x > two_zb ? spread - left : near)};
}

/* Integrates over the depth z = e^t by the trapezoidal rule. Its error is below 1e-18, relative. */
static struct NAME(depths) NAME(at_all_depths)(const form_part *p, REAL x) {
  const REAL step = (REAL)0.15Q, ratio = (REAL)1.1618342427282831226166202143316552Q;
  const struct NAME(table_2) table = NAME(table_2_of)(p);
  struct NAME(depths) sum = {0, 0, 0};
  for (REAL z = (x < 1 ? x : 1) * 4e-18L; z < 64; z *= ratio) {
    const struct NAME(depths) at = NAME(at_depth)(&table, x, z);
    const REAL light = step * z * EXP(-z);
    sum.R += light * at.R;
    sum.slope += light * at.slope;
    sum.energy += (table.mu > 0 ? step * z * EXP(-z * (1 + table.mu)) : light) * at.energy;
  }
  return sum;
}

/* Sums over the nodes of single scattering: of R r, of -dR/dr r^2, and the energy within r. */
static struct NAME(depths) NAME(at_all_angles)(const form_part *p, REAL tau) {
  const REAL least = (REAL)p->least;
  REAL energy = 0;
  int first = 0; /* at the nodes before this one e^(-tau further) is 1 to 22 digits */
  while (first + 1 < FORM_SINGLE_NODES && tau * (REAL)p->further[first] < 1e-22L) {
    first++;
  }
  REAL sum = (REAL)p->weight_before[first], steep = sum * (1 + tau * least);
  const bool whole = tau * least > 90;
  for (int i = whole ? first : 0; i < FORM_SINGLE_NODES; i++) {
    const REAL further = (REAL)p->further[i], all = tau * (further + least);
    if (tau * further < 100 && i >= first) {
      const REAL left = (REAL)p->weight[i] * EXP(-tau * further);
      sum += left;
      steep += left * (1 + all);
    }
    energy -= whole ? 0 : (REAL)p->energy[i] * (all < 90 ? EXPM1(-all) : -1);
  }
  return (struct NAME(depths)){sum, steep, whole ? (REAL)p->sum : energy};
}

#undef REAL
#undef EXP
#undef EXPM1
#undef SQRT
#undef NAME
