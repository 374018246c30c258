/* Each octave of x has Chebyshev series in t = x / 2^e - 1, from 0 to 1: of Q, and of the energy
 * within. */
#include "core/varying/rows.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/transport/anisotropic.h"
#include "core/transport/functions.h"
#include "core/transport/transport.h"

enum { TERMS = ROWS_TERMS, BASES = 3, STEPS = 40, KAPPA_TERMS = 32 };

/* The series of kappa / s has a relative error of 1e-6 (for g above 0.5 less), which puts R off by
 * 25e-6 at 25 decay lengths. */
#define INTERPOLATES_FROM 3e-4
#define INTERPOLATES_ERROR 3e-5

struct rows {
  const transport_table *table;
  transport_slice *slice;
  double g;
  double s_least; /* of the largest albedo of the table */
  double w_least;
  double point[TERMS];        /* Chebyshev points, from 0 to 1 */
  double basis[TERMS][TERMS]; /* [i][k]: weight of the value at point i in term k */
  /* If g is not 0: kappa / s as a Chebyshev series in the coordinate u of the table. Solving for
   * kappa takes longer than all else. */
  double u[2];
  double kappa_per_s[KAPPA_TERMS];
  bool interpolates;
  rows_row *base[2][BASES]; /* from which rows are extrapolated: to small s, and to small w */
};

/* ---- series ---------------------------------------------------------------------------------- */

static void set_points(rows *all) {
  for (int i = 0; i < TERMS; i++) {
    double sine, cosine;
    fn_sincos(FN_PI * (i + 0.5) / TERMS, &sine, &cosine);
    all->point[i] = 0.5 * (1 - cosine);
    double before = 1, now = -cosine;
    for (int k = 0; k < TERMS; k++) {
      all->basis[i][k] = (k == 0 ? 1.0 : 2.0) / TERMS * before;
      const double next = -2 * cosine * now - before;
      before = now;
      now = next;
    }
  }
}

static void fit(const rows *all, const double *values, double *terms) {
  for (int k = 0; k < TERMS; k++) {
    double sum = 0;
    for (int i = 0; i < TERMS; i++) {
      sum += values[i] * all->basis[i][k];
    }
    terms[k] = sum;
  }
}

/* Returns the series at t from 0 to 1, by Clenshaw's recurrence. */
static double sum_of(const double *terms, double t) {
  const double s = 2 * t - 1;
  double next = 0, after = 0;
  for (int k = TERMS - 1; k >= 1; k--) {
    const double sum = terms[k] + 2 * s * next - after;
    after = next;
    next = sum;
  }
  return terms[0] + s * next - after;
}

/* Sets out to the integral from 0 to t of the series; its last term is dropped. The integral of T_k
 * is T_(k+1) / (2 (k + 1)) - T_(k-1) / (2 (k - 1)). */
static void integrate(const double *terms, double *out) {
  double begin = 0;
  for (int k = 1; k < TERMS; k++) {
    const double above = k + 1 < TERMS ? terms[k + 1] : 0;
    const double below = k == 1 ? 2 * terms[0] : terms[k - 1];
    out[k] = 0.5 * (below - above) / (2 * k);
    begin += k % 2 ? -out[k] : out[k];
  }
  out[0] = -begin;
}

/* Returns the octave of x, and sets *t. */
static int octave_of(double x, double *t) {
  int exponent;
  *t = 2 * frexp(x, &exponent) - 1;
  return exponent - 1 - ROWS_FIRST;
}

/* ---- kappa -------------------------------------------------------------------------------- */

static double solved_kappa(const rows *all, double albedo) {
  return all->g != 0 ? transport_anisotropic_kappa(albedo, all->g) : transport_kappa(albedo);
}

/* Sets the series of kappa / s between the albedos that the table covers. */
static void set_kappa(rows *all) {
  enum { N = KAPPA_TERMS };
  all->u[0] = transport_table_u(1);
  all->u[1] = transport_table_u(all->table->field[TRANSPORT_TABLE_ALBEDO_LEAST]);
  for (int i = 0; i < N; i++) {
    double sine, cosine;
    fn_sincos(FN_PI * (i + 0.5) / N, &sine, &cosine);
    const double albedo =
        transport_table_albedo_of_u(all->u[0] + 0.5 * (all->u[1] - all->u[0]) * (1 + cosine));
    const double value = solved_kappa(all, albedo) / sqrt(1 - albedo);
    double before = 1, now = cosine;
    for (int k = 0; k < N; k++) {
      all->kappa_per_s[k] += (k == 0 ? 1.0 : 2.0) / N * value * before;
      const double next = 2 * cosine * now - before;
      before = now;
      now = next;
    }
  }
}

static double kappa_of(const rows *all, double albedo) {
  if (!all->interpolates || albedo < all->table->field[TRANSPORT_TABLE_ALBEDO_LEAST]) {
    return solved_kappa(all, albedo);
  }
  const double s = 2 * (transport_table_u(albedo) - all->u[0]) / (all->u[1] - all->u[0]) - 1;
  double next = 0, after = 0;
  for (int k = KAPPA_TERMS - 1; k >= 1; k--) {
    const double sum = all->kappa_per_s[k] + 2 * s * next - after;
    after = next;
    next = sum;
  }
  return (all->kappa_per_s[0] + s * next - after) * sqrt(1 - albedo);
}

/* ---- one medium ------------------------------------------------------------------------------ */

/* Q from the table, and beyond its reach as core/models/transport.c continues R. */
struct source {
  const transport_series *series;
  double ln_last, Q_last;
  double steeper, fading;
};

static double tabulated(const transport_series *series, double y) {
  const double kept = fmin(fmax(y, series->edge[0]), series->edge[TRANSPORT_TABLE_PANELS]);
  const double kx = series->kappa * fn_exp(kept);
  return transport_series_at(series, kept) - series->ln_albedo - fn_log(1 + kx);
}

#define LAST 1e4 /* mean free paths, as in core/models/transport.c */

static struct source source_of(const transport_series *series) {
  const double h = 1e-3, last = series->edge[TRANSPORT_TABLE_PANELS];
  struct source source = {series, last, tabulated(series, last), 0, 0};
  const double slope =
      (3 * source.Q_last - 4 * tabulated(series, last - h) + tabulated(series, last - 2 * h)) /
      (2 * h);
  const bool fades = fn_exp(last) > 0.5 * LAST;
  source.steeper = fades ? 0 : -2 - slope;
  source.fading = fades ? -2 - slope : 0;
  return source;
}

static double Q_at(const struct source *source, double y) {
  const double beyond = y - source->ln_last;
  if (!(beyond > 0)) {
    return tabulated(source->series, y);
  }
  return source->Q_last - (2 + source->steeper) * beyond -
         0.5 * source->fading * (1 - fn_exp(-2 * beyond));
}

/* Sums the energy of a row from its Q. For g other than 0, R is scaled to the total as
 * core/models/transport.c does. */
static void sum_energy(const rows *all, rows_row *row) {
  double part[ROWS_OCTAVES];
  const double near = 2 * FN_PI * row->albedo * fn_exp(rows_Q(row, ldexp(1, ROWS_FIRST)));
  double energy = near * ldexp(1, ROWS_FIRST);
  row->before[0] = energy;
  for (int i = 0; i < ROWS_OCTAVES; i++) {
    const double begin = ldexp(1, ROWS_FIRST + i);
    double density[TERMS], terms[TERMS];
    for (int k = 0; k < TERMS; k++) {
      const double x = begin * (1 + all->point[k]), kx = row->kappa * x;
      density[k] = 2 * FN_PI * row->albedo * begin * (1 + kx) *
                   fn_exp(sum_of(row->Q[i], all->point[k]) - kx);
    }
    fit(all, density, terms);
    integrate(terms, row->within[i]);
    part[i] = sum_of(row->within[i], 1);
    energy += part[i];
    row->before[i + 1] = energy;
  }
  row->beyond[ROWS_OCTAVES] = 0;
  for (int i = ROWS_OCTAVES; i-- > 0;) {
    row->beyond[i] = row->beyond[i + 1] + part[i] / energy;
    for (int k = 0; k < TERMS; k++) {
      row->within[i][k] /= energy;
    }
    row->before[i + 1] /= energy;
    row->Q[i][0] += all->g != 0 ? fn_log(row->total / energy) : 0;
  }
  row->before[0] /= energy;
}

/* Sets Q of a row to that of a medium of the table. */
static void fill_tabulated(const rows *all, rows_row *row) {
  transport_series series;
  transport_slice_look_up(all->slice, row->albedo, kappa_of(all, row->albedo), &series);
  const struct source source = source_of(&series);
  row->kappa = series.kappa;
  for (int i = 0; i < ROWS_OCTAVES; i++) {
    double values[TERMS];
    for (int k = 0; k < TERMS; k++) {
      values[k] = Q_at(&source, fn_log(ldexp(1 + all->point[k], ROWS_FIRST + i)));
    }
    fit(all, values, row->Q[i]);
  }
}

/* Sets Q to the parabola through three rows, as a function of s or w. */
static void extrapolate(rows_row *const base[BASES], bool by_s, rows_row *row) {
  double at[BASES], weight[BASES];
  for (int i = 0; i < BASES; i++) {
    at[i] = by_s ? base[i]->s : base[i]->w;
  }
  for (int i = 0; i < BASES; i++) {
    weight[i] = 1;
    for (int k = 0; k < BASES; k++) {
      weight[i] *= k == i ? 1 : ((by_s ? row->s : row->w) - at[k]) / (at[i] - at[k]);
    }
  }
  for (int i = 0; i < ROWS_OCTAVES; i++) {
    for (int k = 0; k < TERMS; k++) {
      row->Q[i][k] = weight[0] * base[0]->Q[i][k] + weight[1] * base[1]->Q[i][k] +
                     weight[2] * base[2]->Q[i][k];
    }
  }
}

double rows_kappa_per_s(const rows *all, double s, double w) {
  const double least = fmax(s, all->s_least);
  return kappa_of(all, s > all->s_least ? w * (1 + s) : (1 - least) * (1 + least)) / least;
}

/* Near s = 0 a total is 1 less a multiple of s; the multiple is extrapolated in a straight line. */
transport_slice_sums rows_totals(const rows *all, double s, double w) {
  if (s >= all->s_least) {
    return transport_slice_total(all->slice, w * (1 + s));
  }
  const double h = all->s_least;
  const transport_slice_sums one = transport_slice_total(all->slice, (1 - h) * (1 + h));
  const transport_slice_sums two = transport_slice_total(all->slice, (1 - 2 * h) * (1 + 2 * h));
  const double share = (s - h) / h;
  const double beam = (1 - one.beam) / h, diffuse = (1 - one.diffuse) / h;
  return (transport_slice_sums){
      1 - s * (beam + share * ((1 - two.beam) / (2 * h) - beam)),
      1 - s * (diffuse + share * ((1 - two.diffuse) / (2 * h) - diffuse)),
  };
}

void rows_fill(const rows *all, double s, double w, rows_row *row) {
  row->s = s;
  row->w = w;
  row->albedo = w * (1 + s);
  const transport_slice_sums totals = rows_totals(all, s, w);
  row->total = totals.beam;
  row->total_diffuse = totals.diffuse;
  if (s < all->s_least || w < all->w_least) {
    row->kappa = s < all->s_least ? s * rows_kappa_per_s(all, s, w) : kappa_of(all, row->albedo);
    extrapolate(all->base[s < all->s_least ? 0 : 1], s < all->s_least, row);
  } else {
    fill_tabulated(all, row);
  }
  sum_energy(all, row);
}

/* ---- all rows -------------------------------------------------------------------------------- */

double rows_error(const rows *all) {
  return all->interpolates ? INTERPOLATES_ERROR : 0;
}

double rows_w_least(const rows *all) {
  return all->w_least;
}

rows *rows_create(const transport_table *table, double g, double eta, double tolerance) {
  rows *all = calloc(1, sizeof *all);
  rows_row *base = calloc(2 * BASES, sizeof *base);
  transport_slice *slice = transport_slice_create(table, g, eta);
  if (all == NULL || base == NULL || slice == NULL) {
    free(all);
    free(base);
    free(slice);
    return NULL;
  }
  const double least = table->field[TRANSPORT_TABLE_ALBEDO_LEAST];
  all->table = table;
  all->slice = slice;
  all->g = g;
  /* a little inside, so that rounding stays in the table */
  all->s_least = sqrt(1 - table->field[TRANSPORT_TABLE_ALBEDO_MOST]) * (1 + 1e-9);
  all->w_least = least / (1 + sqrt(1 - least)) * (1 + 1e-9);
  all->interpolates = g != 0 && tolerance >= INTERPOLATES_FROM;
  if (all->interpolates) {
    set_kappa(all);
  }
  set_points(all);
  for (int i = 0; i < BASES; i++) {
    all->base[0][i] = &base[i];
    all->base[1][i] = &base[BASES + i];
    const double s = all->s_least * (1 + i), w = all->w_least * (1 + 0.02 * i);
    base[i] = (rows_row){.s = s, .w = 1 - s, .albedo = (1 - s) * (1 + s)};
    base[BASES + i] = (rows_row){.s = 1 - w, .w = w, .albedo = w * (2 - w)};
    fill_tabulated(all, &base[i]);
    fill_tabulated(all, &base[BASES + i]);
  }
  return all;
}

void rows_free(rows *all) {
  if (all != NULL) {
    free(all->base[0][0]);
    free(all->slice);
    free(all);
  }
}

/* ---- the functions of a row ------------------------------------------------------------------ */

double rows_Q(const rows_row *row, double x) {
  double t;
  const int octave = octave_of(x, &t);
  return octave < 0 ? sum_of(row->Q[0], 0) : sum_of(row->Q[octave], t);
}

double rows_cdf(const rows_row *row, double x) {
  double t;
  const int octave = octave_of(x, &t);
  return octave < 0 ? row->before[0] * ldexp(x, -ROWS_FIRST)
                    : row->before[octave] + sum_of(row->within[octave], t);
}

/* Returns x in an octave where the energy within the octave is `wanted`: Newton's method in a
 * bracket. */
static double search(const rows_row *row, int octave, double wanted) {
  const double *terms = row->within[octave];
  double low = 0, high = 1, t = fmin(fmax(wanted / sum_of(terms, 1), 0), 1);
  for (int i = 0; i < STEPS; i++) {
    const double s = 2 * t - 1;
    double next = 0, after = 0, next_slope = 0, after_slope = 0;
    for (int k = TERMS - 1; k >= 1; k--) {
      const double slope = 2 * (next + s * next_slope) - after_slope;
      const double sum = terms[k] + 2 * s * next - after;
      after = next;
      next = sum;
      after_slope = next_slope;
      next_slope = slope;
    }
    const double off = terms[0] + s * next - after - wanted;
    const double slope = 2 * (next + s * next_slope - after_slope);
    low = off < 0 ? t : low;
    high = off < 0 ? high : t;
    const double newton = t - off / slope;
    const double middle = 0.5 * (low + high);
    const double step = newton >= low && newton <= high ? newton : middle;
    const bool last = fabs(step - t) < 1e-9;
    t = step;
    if (last) {
      break;
    }
  }
  return ldexp(1 + t, ROWS_FIRST + octave);
}

double rows_radius(const rows_row *row, double u) {
  if (u < row->before[0]) {
    return ldexp(u / row->before[0], ROWS_FIRST);
  }
  int octave = 0;
  while (octave < ROWS_OCTAVES - 1 && row->before[octave + 1] < u) {
    octave++;
  }
  return search(row, octave, u - row->before[octave]);
}

double rows_radius_of_rest(const rows_row *row, double rest) {
  int octave = ROWS_OCTAVES - 1;
  while (octave > 0 && row->beyond[octave] < rest) {
    octave--;
  }
  return search(row, octave, fmax(row->beyond[octave] - rest, 0));
}
