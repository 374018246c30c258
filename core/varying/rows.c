/* Computes the rows of a surface. The energy within x is a Chebyshev series in x for each panel. Q
 * comes from the table's series; some of their edges move with the albedo, and those are no edges
 * of panels. */
#include "core/varying/rows.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/chebyshev.h"
#include "core/transport/decay.h"
#include "core/transport/functions.h"

enum { TERMS = ROWS_TERMS, BASES = ROWS_BASES, STEPS = 40, KAPPA_TERMS = 32, TOGETHER = 64 };

/* The series of kappa / s has a relative error of 1e-6, which puts R off by 25e-6 at 25 decay lengths;
 * for g above 0.5, and for albedos from 0.6 on, it is 5e-8. */
#define INTERPOLATES_FROM 3e-4 /* least tolerance for which the series serves all albedos */
#define INTERPOLATES_ERROR 3e-5
#define INTERPOLATES_ALBEDO 0.6 /* least albedo for which the series serves smaller tolerances */
#define INTERPOLATES_ALBEDO_ERROR 1.5e-6

struct rows {
  const transport_table *table;
  transport_slice *slice;
  double g;
  double s_least; /* s of the largest albedo of the table */
  double w_least;
  double point[TERMS]; /* Chebyshev points, mapped to 0 to 1 */
  int panels;
  double edge[ROWS_PANELS_MAX + 1];
  int panel_of_octave[ROWS_OCTAVES]; /* index of the first panel of each octave */
  double x[ROWS_PANELS_MAX][TERMS], ln_x[ROWS_PANELS_MAX][TERMS];
  double basis[TERMS][TERMS]; /* basis[i][k]: the weight of the value at point i in term k */
  /* If g is not 0: kappa / s as a Chebyshev series in the table's coordinate u, because solving for
   * kappa takes longer than everything else. u: the range of the series. */
  double u[2];
  double kappa_per_s[KAPPA_TERMS];
  double interpolates_from; /* albedo */
  double error;
  /* [0]: values of s from which rows of smaller s are extrapolated; [1]: of w likewise */
  double base_at[2][BASES];
  rows_source base[2][BASES];
  /* Q of these media at the points of the panels */
  double base_Q[2][BASES][ROWS_PANELS_MAX][TERMS];
};

/* ---- series ---------------------------------------------------------------------------------- */

static void set_points(rows *all) {
  for (int i = 0; i < TERMS; i++) {
    double sine, cosine;
    fn_sincos(FN_PI * (i + 0.5) / TERMS, &sine, &cosine);
    all->point[i] = 0.5 * (1 - cosine);
    core_chebyshev_polynomials(TERMS, -cosine, all->basis[i]);
    for (int k = 0; k < TERMS; k++) {
      all->basis[i][k] *= (k == 0 ? 1.0 : 2.0) / TERMS;
    }
  }
}

/* Returns fixed edge number i of the table's series, in mean free paths. */
static double fixed_edge(const transport_table *table, int i) {
  const int near = TRANSPORT_TABLE_NEAR + 1;
  return table->field[i < near ? TRANSPORT_TABLE_EDGES + i : TRANSPORT_TABLE_D_EDGES + i - near];
}

static void set_panels(rows *all) {
  for (int octave = 0; octave < ROWS_OCTAVES; octave++) {
    const double begin = ldexp(1, ROWS_FIRST + octave);
    all->panel_of_octave[octave] = all->panels;
    /* Near the source and far away x R is a power of x, and two octaves are one panel. */
    const bool wide = ROWS_FIRST + octave < 0 || ROWS_FIRST + octave >= ROWS_END;
    if (wide && octave % 2 == 1) {
      all->panel_of_octave[octave] = all->panel_of_octave[octave - 1];
      continue;
    }
    const double end = (wide ? 4 : 2) * begin;
    double x = begin;
    while (x < end) {
      double next = end;
      for (int i = 0; i < ROWS_CUTS_MAX; i++) {
        const double edge = fixed_edge(all->table, i);
        next = edge > x && edge < next ? edge : next;
      }
      all->edge[all->panels++] = x;
      x = next;
    }
    all->edge[all->panels] = x;
  }
  for (int panel = 0; panel < all->panels; panel++) {
    for (int i = 0; i < TERMS; i++) {
      all->x[panel][i] =
          all->edge[panel] + all->point[i] * (all->edge[panel + 1] - all->edge[panel]);
      all->ln_x[panel][i] = fn_log(all->x[panel][i]);
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
    const double sum = (terms[k] - after) + 2 * s * next;
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

/* Returns the panel that contains x, and sets *t to the place in it, 0 to 1. x is in an octave with
 * rows. */
static int panel_of(const rows *all, double x, double *t) {
  int exponent;
  frexp(x, &exponent);
  int panel = all->panel_of_octave[exponent - 1 - ROWS_FIRST];
  while (x >= all->edge[panel + 1]) {
    panel++;
  }
  *t = (x - all->edge[panel]) / (all->edge[panel + 1] - all->edge[panel]);
  return panel;
}

/* ---- kappa -------------------------------------------------------------------------------- */

static double solved_kappa(const rows *all, double albedo) {
  return all->g != 0 ? transport_anisotropic_kappa(albedo, all->g) : transport_kappa(albedo);
}

/* Sets the series of kappa / s, where s = sqrt(1 - albedo), over all albedos of the table. */
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
    double polynomial[N];
    core_chebyshev_polynomials(N, cosine, polynomial);
    for (int k = 0; k < N; k++) {
      all->kappa_per_s[k] += (k == 0 ? 1.0 : 2.0) / N * value * polynomial[k];
    }
  }
}

static double kappa_of(const rows *all, double albedo) {
  if (albedo < all->interpolates_from) {
    return solved_kappa(all, albedo);
  }
  const double s = 2 * (transport_table_u(albedo) - all->u[0]) / (all->u[1] - all->u[0]) - 1;
  return core_chebyshev_sum(KAPPA_TERMS, all->kappa_per_s, s) * sqrt(1 - albedo);
}

/* ---- one medium ------------------------------------------------------------------------------ */

#define LAST 1e4 /* mean free paths, as in core/models/transport.c */

static double kappa_of_row(const rows *all, double s, double w) {
  return s < all->s_least ? s * rows_kappa_per_s(all, s, w) : kappa_of(all, w * (1 + s));
}

static void set_source(const rows *all, double albedo, rows_source *source) {
  transport_slice_look_up(all->slice, albedo, kappa_of(all, albedo), &source->series);
  const double h = 1e-3, last = source->series.edge[TRANSPORT_TABLE_PANELS];
  double Q[3];
  transport_series_Q(&source->series, 3, (double[]){last - 2 * h, last - h, last}, Q);
  const double slope = (3 * Q[2] - 4 * Q[1] + Q[0]) / (2 * h);
  const bool fades = fn_exp(last) > 0.5 * LAST;
  source->last_Q = Q[2];
  source->steeper = fades ? 0 : -2 - slope;
  source->fading = fades ? -2 - slope : 0;
}

/* Sets Q[n] to the Q of a source (core/transport/table.h) at ln x = y[n], which ascends. */
static void source_Q(const rows_source *source, size_t n, const double *y, double *Q) {
  const double last = source->series.edge[TRANSPORT_TABLE_PANELS];
  transport_series_Q(&source->series, n, y, Q);
  for (size_t i = 0; i < n; i++) {
    const double beyond = y[i] - last;
    if (beyond > 0) {
      Q[i] = source->last_Q - (2 + source->steeper) * beyond -
             0.5 * source->fading * (1 - fn_exp(-2 * beyond));
    }
  }
}

void rows_Q(const rows_row *row, size_t n, const double *y, double *Q) {
  for (size_t i = 0; i < n; i++) {
    Q[i] = row->lift;
  }
  for (int k = 0; k < BASES && row->base[k] != NULL; k++) {
    for (size_t done = 0; done < n; done += TOGETHER) {
      const size_t count = n - done < TOGETHER ? n - done : TOGETHER;
      double here[TOGETHER];
      source_Q(row->base[k], count, y + done, here);
      for (size_t i = 0; i < count; i++) {
        Q[done + i] += row->weight[k] * here[i];
      }
    }
  }
}

/* Sets Q[TERMS] to Q at the points of a panel, without the row's lift. */
static void panel_Q(const rows *all, const rows_row *row, int panel, double *Q) {
  if (row->base[0] == &row->source) {
    source_Q(&row->source, TERMS, all->ln_x[panel], Q);
    return;
  }
  const double(*base)[ROWS_PANELS_MAX][TERMS] = all->base_Q[row->s < all->s_least ? 0 : 1];
  for (int i = 0; i < TERMS; i++) {
    Q[i] = row->weight[0] * base[0][panel][i] + row->weight[1] * base[1][panel][i] +
           row->weight[2] * base[2][panel][i];
  }
}

/* The energy beyond this many decay lengths is neglected. */
#define DECAYS_MOST 80

/* Integrates Q of a row to its energies. For g other than 0 it scales R to the total, as
 * core/models/transport.c does. */
static void sum_energy(const rows *all, rows_row *row) {
  double part[ROWS_PANELS_MAX];
  double Q[TERMS];
  rows_Q(row, 1, (double[]){ROWS_FIRST * FN_LN2}, Q);
  double energy = 2 * FN_PI * row->albedo * fn_exp(Q[0]) * all->edge[0];
  memset(row->within, 0, sizeof row->within);
  row->before[0] = energy;
  for (int i = 0; i < all->panels; i++) {
    const double width = all->edge[i + 1] - all->edge[i];
    part[i] = 0;
    if (row->kappa * all->edge[i] < DECAYS_MOST) {
      double density[TERMS], terms[TERMS];
      panel_Q(all, row, i, Q);
      for (int k = 0; k < TERMS; k++) {
        const double kx = row->kappa * all->x[i][k];
        density[k] = 2 * FN_PI * row->albedo * width * (1 + kx) * fn_exp(Q[k] - kx);
      }
      fit(all, density, terms);
      integrate(terms, row->within[i]);
      part[i] = sum_of(row->within[i], 1);
    }
    energy += part[i];
    row->before[i + 1] = energy;
  }
  row->beyond[all->panels] = 0;
  for (int i = all->panels; i-- > 0;) {
    row->beyond[i] = row->beyond[i + 1] + part[i] / energy;
    for (int k = 0; k < TERMS; k++) {
      row->within[i][k] /= energy;
    }
    row->before[i + 1] /= energy;
  }
  row->before[0] /= energy;
  row->lift = all->g != 0 ? fn_log(row->total / energy) : 0;
}

/* Sets the weights of quadratic extrapolation from three bases to s = place, or to w = place. */
static void set_weights(const rows *all, bool by_s, double place, double weight[BASES]) {
  const double *at = all->base_at[by_s ? 0 : 1];
  for (int i = 0; i < BASES; i++) {
    weight[i] = 1;
    for (int k = 0; k < BASES; k++) {
      weight[i] *= k == i ? 1 : (place - at[k]) / (at[i] - at[k]);
    }
  }
}

static void extrapolate(const rows *all, bool by_s, rows_row *row) {
  set_weights(all, by_s, by_s ? row->s : row->w, row->weight);
  for (int i = 0; i < BASES; i++) {
    row->base[i] = &all->base[by_s ? 0 : 1][i];
  }
}

double rows_kappa_per_s(const rows *all, double s, double w) {
  const double least = fmax(s, all->s_least);
  return kappa_of(all, s > all->s_least ? w * (1 + s) : (1 - least) * (1 + least)) / least;
}

/* Returns a total below the table's least albedo. There a total is nearly proportional to the
 * albedo; the quotient is extrapolated quadratically. */
static double total_below(const rows *all, bool diffuse, double w) {
  double weight[BASES], sum = 0;
  set_weights(all, false, w, weight);
  for (int i = 0; i < BASES; i++) {
    const double base = all->base_at[1][i];
    const double per_albedo = weight[i] * (w * (2 - w)) / (base * (2 - base));
    sum += per_albedo * transport_slice_total(all->slice, diffuse, base * (2 - base));
  }
  return sum;
}

/* Near s = 0 a total is 1 less a multiple of s; the multiple is extrapolated in a straight line. */
double rows_total(const rows *all, bool diffuse, double s, double w) {
  if (w < all->w_least) {
    return total_below(all, diffuse, w);
  }
  if (s >= all->s_least) {
    return transport_slice_total(all->slice, diffuse, w * (1 + s));
  }
  const double h = all->s_least;
  const double one = transport_slice_total(all->slice, diffuse, (1 - h) * (1 + h));
  const double two = transport_slice_total(all->slice, diffuse, (1 - 2 * h) * (1 + 2 * h));
  const double share = (s - h) / h, per_s = (1 - one) / h;
  return 1 - s * (per_s + share * ((1 - two) / (2 * h) - per_s));
}

void rows_fill(const rows *all, double s, double w, rows_row *row) {
  row->all = all;
  row->s = s;
  row->w = w;
  row->albedo = w * (1 + s);
  row->total = rows_total(all, false, s, w);
  row->kappa = kappa_of_row(all, s, w);
  row->lift = 0;
  if (s < all->s_least || w < all->w_least) {
    extrapolate(all, s < all->s_least, row);
  } else {
    set_source(all, row->albedo, &row->source);
    row->base[0] = &row->source;
    row->base[1] = row->base[2] = NULL;
    row->weight[0] = 1;
  }
  sum_energy(all, row);
}

/* ---- all rows -------------------------------------------------------------------------------- */

double rows_error(const rows *all) {
  return all->error;
}

double rows_w_least(const rows *all) {
  return all->w_least;
}

rows *rows_create(const transport_table *table, double g, double eta, double tolerance) {
  rows *all = calloc(1, sizeof *all);
  transport_slice *slice = transport_slice_create(table, g, eta);
  if (all == NULL || slice == NULL) {
    free(all);
    free(slice);
    return NULL;
  }
  const double least = table->field[TRANSPORT_TABLE_ALBEDO_LEAST];
  all->table = table;
  all->slice = slice;
  all->g = g;
  /* A little inside the table, so that rounding cannot leave it. */
  all->s_least = sqrt(1 - table->field[TRANSPORT_TABLE_ALBEDO_MOST]) * (1 + 1e-9);
  all->w_least = least / (1 + sqrt(1 - least)) * (1 + 1e-9);
  all->interpolates_from = (double)INFINITY;
  if (g != 0) {
    const bool everywhere = tolerance >= INTERPOLATES_FROM;
    set_kappa(all);
    all->interpolates_from = everywhere ? least : INTERPOLATES_ALBEDO;
    all->error = everywhere ? INTERPOLATES_ERROR : INTERPOLATES_ALBEDO_ERROR;
  }
  set_points(all);
  set_panels(all);
  for (int i = 0; i < BASES; i++) {
    const double s = all->s_least * (1 + i), w = all->w_least * (1 + 0.02 * i);
    all->base_at[0][i] = s;
    all->base_at[1][i] = w;
    set_source(all, (1 - s) * (1 + s), &all->base[0][i]);
    set_source(all, w * (2 - w), &all->base[1][i]);
    for (int panel = 0; panel < all->panels; panel++) {
      source_Q(&all->base[0][i], TERMS, all->ln_x[panel], all->base_Q[0][i][panel]);
      source_Q(&all->base[1][i], TERMS, all->ln_x[panel], all->base_Q[1][i][panel]);
    }
  }
  return all;
}

void rows_free(rows *all) {
  if (all != NULL) {
    free(all->slice);
    free(all);
  }
}

size_t rows_edges(const rows_row *row, double x[ROWS_EDGES_MAX]) {
  size_t count = 0;
  for (int i = 0; i < BASES; i++) {
    if (row->base[i] != &row->source) {
      continue;
    }
    const transport_series *series = &row->source.series;
    for (int part = 0; part < (series->g == 0 ? 1 : 2); part++) {
      for (int k = 0; k <= TRANSPORT_TABLE_PANELS; k++) {
        const double edge = fn_exp(part == 0 ? series->edge[k] : series->difference.edge[k]);
        size_t at = count;
        const bool inside = edge > ldexp(1, ROWS_FIRST) && edge < ldexp(1, ROWS_END);
        for (; inside && at > 0 && x[at - 1] > edge; at--) {
          x[at] = x[at - 1];
        }
        if (inside) {
          x[at] = edge;
          count++;
        }
      }
    }
  }
  return count;
}

/* ---- the functions of a row ------------------------------------------------------------------ */

double rows_cdf(const rows_row *row, double x) {
  if (x < row->all->edge[0]) {
    return row->before[0] * ldexp(x, -ROWS_FIRST);
  }
  double t;
  const int panel = panel_of(row->all, x, &t);
  return row->before[panel] + sum_of(row->within[panel], t);
}

/* Newton's method squares its error, so the step after one of this size leaves about 1e-9. */
#define SEARCHED 3e-5

/* Solves for x in a panel: the energy from the panel's start to x is `wanted`. Newton's method in a
 * bracket, started from *last. energy: u or -rest of this radius; differences to that of *last give
 * the start. */
static double search(const rows_row *row, int panel, double wanted, double energy,
                     rows_found *last) {
  const double *terms = row->within[panel], *edge = &row->all->edge[panel];
  const double width = edge[1] - edge[0], ahead = energy - last->energy;
  const double guess = last->per_energy > 0 ? (last->x + last->per_energy * ahead - edge[0]) / width
                                            : wanted / sum_of(terms, 1);
  double low = 0, high = 1, t = fmin(fmax(guess, 0), 1), slope = 0;
  for (int i = 0; i < STEPS; i++) {
    const double s = 2 * t - 1;
    double next = 0, after = 0, next_slope = 0, after_slope = 0;
    for (int k = TERMS - 1; k >= 1; k--) {
      const double sum_slope = (2 * next - after_slope) + 2 * s * next_slope;
      /* this order of operations has the shortest chain of dependencies */
      const double sum = (terms[k] - after) + 2 * s * next;
      after = next;
      next = sum;
      after_slope = next_slope;
      next_slope = sum_slope;
    }
    const double off = terms[0] + s * next - after - wanted;
    slope = 2 * (next + s * next_slope - after_slope);
    low = off < 0 ? t : low;
    high = off < 0 ? high : t;
    const double newton = t - off / slope;
    const double middle = 0.5 * (low + high);
    const double step = newton >= low && newton <= high ? newton : middle;
    const bool ends = fabs(step - t) < SEARCHED;
    t = step;
    if (ends) {
      break;
    }
  }
  *last = (rows_found){energy, edge[0] + t * width, width / slope};
  return last->x;
}

double rows_radius(const rows_row *row, double u, rows_found *last) {
  if (u < row->before[0]) {
    return ldexp(u / row->before[0], ROWS_FIRST);
  }
  int panel = 0;
  while (panel < row->all->panels - 1 && row->before[panel + 1] < u) {
    panel++;
  }
  return search(row, panel, u - row->before[panel], u, last);
}

double rows_radius_of_rest(const rows_row *row, double rest, rows_found *last) {
  int panel = row->all->panels - 1;
  while (panel > 0 && row->beyond[panel] < rest) {
    panel--;
  }
  return search(row, panel, fmax(row->beyond[panel] - rest, 0), -rest, last);
}
