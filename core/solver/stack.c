/* Layers at one wavenumber, one above the other. J+ and J- are the light on its way down and up, u and
 * v their sum and difference. With the sum S and the difference D of a layer's relations (layer.c),
 * its upper face 1 and lower face 2, and v = Z u of what is below,
 *
 *   v1 = (S u1 - D u2) / 2,   Z u2 = (D u1 - S u2) / 2:
 *
 * u2 = (S / 2 + Z)^-1 D u1 / 2, and v1 = (S - D (S / 2 + Z)^-1 D / 2) u1 / 2. Where the index changes
 * from n1 to n2, with mu2 from n1 sin1 = n2 sin2 and Fresnel's transmittance T(mu),
 *
 *   T11 = <psi1 mu1 T psi1>, T22 = <psi2 mu2 T psi2>, T12 = <psi2(mu2) mu1 T psi1(mu1)>,
 *   R1 = 1 - T11, R2 = 1 - T22, down = T12, up = (n1 / n2)^2 T12^T,
 *   Q = (1 - R2 rho)^-1 down,  rb = R1 + up rho Q
 *
 * with rho the reflectance of what is below the step, and rb that of the step with it. */
#include "core/solver/stack.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/solver/layer.h"
#include "core/transport/functions.h"
#include "core/transport/gauss.h"
#include "core/transport/single.h"

enum { ALIGNMENT_BYTES = 64, SIDES = 2 };

/* A step: the boundary below a layer, where the index may change. Matrices have the beam's row and
 * column. `same`: the indices are equal, and the matrices are not used. */
struct step {
  bool same;
  dense above, below; /* R1, R2 */
  dense down, up;
};

struct stack {
  const core_isa *isa;
  size_t count;
  const stack_layer *layers;
  const atomic_bool *stop;
  expansion *expanded[SOLVER_LAYERS_MAX];
  struct step step[SOLVER_LAYERS_MAX];
  /* reflectance matrix of the first layer's upper boundary, and of the last layer's lower one */
  dense outer[SIDES];
  double *exit[SIDES];
  double *flux[SOLVER_LAYERS_MAX]; /* <mu psi> for m = 0 */
  double *memory;
};

/* ---- indices ------------------------------------------------------------------------------------ */

/* Edges that are closer together are united. */
#define EDGES_APART 0.04

static int compare_numbers(const void *a, const void *b) {
  const double x = *(const double *)a, y = *(const double *)b;
  return (x > y) - (x < y);
}

/* Sets edge[] to the cosines in a medium of index n beyond which light of this stack is totally
 * reflected anywhere, and to `upright` if that is not 0, and returns their number. */
static size_t find_edges(const stack_layer *layers, size_t count, double below, double n,
                         double upright, double edge[EXPANSION_PANELS_MAX - 1]) {
  double all[SOLVER_LAYERS_MAX + 3] = {upright};
  size_t found = upright > 0, kept = 0;
  for (size_t i = 0; i < count + 2; i++) {
    const double other = i < count ? layers[i].index : i == count ? 1 : below;
    if (other < n) {
      all[found++] = sqrt((1 - other / n) * (1 + other / n));
    }
  }
  qsort(all, found, sizeof *all, compare_numbers);
  for (size_t i = 0; i < found && kept < EXPANSION_PANELS_MAX - 1; i++) {
    if (all[i] > (kept == 0 ? 0 : edge[kept - 1]) + EDGES_APART && all[i] < 1 - EDGES_APART) {
      edge[kept++] = all[i];
    }
  }
  return kept;
}

/* ---- where the index changes ---------------------------------------------------------------------- */

enum { STEP_NODES = 40 };

/* Adds to end[] the cosines, in a medium of index `rare`, of the edges of the functions `of`, which
 * are in a medium of index n. */
static size_t add_ends(const expansion *of, double n, double rare, double *end) {
  size_t count = 0;
  for (size_t i = 1; i < of->panels; i++) {
    const double ratio = n / rare, mu = of->edge[i];
    const double sine2 = ratio * ratio * (1 - mu) * (1 + mu);
    if (sine2 < 1) {
      end[count++] = sqrt(1 - sine2);
    }
  }
  return count;
}

/* Integrates the step's products over the cosine in the rarer medium, in which every direction
 * exists. */
static void integrate_step(struct step *to, const expansion *one, const expansion *two, double n1,
                           double n2) {
  const double rare = fmin(n1, n2), thick = fmax(n1, n2), eta = thick / rare;
  double end[2 * EXPANSION_PANELS_MAX + 2] = {0, 1};
  double psi1[EXPANSION_PANELS_MAX * EXPANSION_DEGREES_MAX];
  double psi2[EXPANSION_PANELS_MAX * EXPANSION_DEGREES_MAX];
  size_t ends = 2;
  ends += add_ends(one, n1, rare, end + ends);
  ends += add_ends(two, n2, rare, end + ends);
  qsort(end, ends, sizeof *end, compare_numbers);
  gauss_rule rule;
  transport_gauss(&rule, STEP_NODES);
  for (size_t piece = 0; piece + 1 < ends; piece++) {
    for (size_t node = 0; node < rule.n; node++) {
      /* the first piece begins at the grazing angle */
      const double v = rule.x[node], length = end[piece + 1] - end[piece];
      const double mu = end[piece] + length * (piece == 0 ? v * v * v : v);
      const double weight = length * rule.weight[node] * (piece == 0 ? 3 * v * v : 1);
      const double sine = sqrt((1 - mu) * (1 + mu)), sine_thick = sine / eta;
      const double mu_thick = sqrt((1 - sine_thick) * (1 + sine_thick));
      const double flux = weight * mu * transport_transmittance(eta, mu_thick, mu);
      const double mu1 = n1 < n2 ? mu : mu_thick, sine1 = n1 < n2 ? sine : sine_thick;
      const double mu2 = n1 < n2 ? mu_thick : mu, sine2 = n1 < n2 ? sine_thick : sine;
      const double flux1 = flux * (rare / n1) * (rare / n1);
      const double flux2 = flux * (rare / n2) * (rare / n2);
      for (size_t m = 0; m <= one->orders; m++) {
        const size_t at1 = one->first[m], size1 = one->first[m + 1] - at1;
        const size_t at2 = two->first[m], size2 = two->first[m + 1] - at2;
        solver_expansion_at(one, m, mu1, sine1, psi1);
        solver_expansion_at(two, m, mu2, sine2, psi2);
        solver_expansion_add_outer(to->above.re + at1 * to->above.stride + at1, to->above.stride,
                                   -flux1, psi1, size1, psi1, size1);
        solver_expansion_add_outer(to->below.re + at2 * to->below.stride + at2, to->below.stride,
                                   -flux2, psi2, size2, psi2, size2);
        solver_expansion_add_outer(to->down.re + at2 * to->down.stride + at1, to->down.stride,
                                   flux1, psi2, size2, psi1, size1);
        solver_expansion_add_outer(to->up.re + at1 * to->up.stride + at2, to->up.stride, flux2,
                                   psi1, size1, psi2, size2);
      }
    }
  }
  for (size_t i = 0; i < one->n; i++) {
    to->above.re[i * to->above.stride + i] += 1;
  }
  for (size_t i = 0; i < two->n; i++) {
    to->below.re[i * to->below.stride + i] += 1;
  }
  const double r0 = solver_beam_reflectance(n1, n2);
  to->above.re[one->n * to->above.stride + one->n] = r0;
  to->below.re[two->n * to->below.stride + two->n] = r0;
  to->down.re[two->n * to->down.stride + one->n] = 1 - r0;
  to->up.re[one->n * to->up.stride + two->n] = 1 - r0;
}

/* ---- making --------------------------------------------------------------------------------------- */

static size_t numbers_of(size_t rows, size_t columns) {
  return 2 * solver_dense_size(rows, columns);
}

static double *reserve(size_t numbers) {
  const size_t bytes =
      (numbers * sizeof(double) + ALIGNMENT_BYTES - 1) / ALIGNMENT_BYTES * ALIGNMENT_BYTES;
  double *memory = aligned_alloc(ALIGNMENT_BYTES, bytes);
  if (memory != NULL) {
    memset(memory, 0, bytes);
  }
  return memory;
}

static bool expand(stack *to, const expansion_rules *rules, double below) {
  for (size_t i = 0; i < to->count; i++) {
    double edge[EXPANSION_PANELS_MAX - 1];
    const double n = to->layers[i].index, etas[SIDES] = {n, n / below};
    const bool first = n == to->layers[0].index;
    const bool last = i + 1 == to->count && isfinite(to->layers[i].thickness);
    const expansion_boundaries boundaries = {
        .count = (size_t)first + (size_t)last,
        .etas = first ? etas : etas + 1,
        .edges = find_edges(to->layers, to->count, below, n, rules->upright, edge),
        .edge = edge,
    };
    to->expanded[i] = solver_expansion_new(to->isa, rules, &to->layers[i].medium, &boundaries);
    if (to->expanded[i] == NULL || solver_stops(to->stop)) {
      return false;
    }
  }
  return true;
}

/* Copies the reflectance, and the functionals of light that leaves, at the boundary of one side. */
static void note_boundary(stack *to, size_t side, const expansion *of, size_t boundary,
                          double eta) {
  const size_t n = of->n;
  for (size_t row = 0; row < n; row++) {
    memcpy(to->outer[side].re + row * to->outer[side].stride, of->reflection[boundary] + row * n,
           n * sizeof(double));
    to->exit[side][row] = of->exit[boundary][0][row];
  }
  to->outer[side].re[n * to->outer[side].stride + n] = solver_beam_reflectance(eta, 1);
}

static void note_flux(const expansion *of, double *flux) {
  for (size_t node = 0; node < of->nodes; node++) {
    for (size_t i = 0; i < of->first[1]; i++) {
      flux[i] += of->weight[node] * of->mu[node] * of->psi[node * of->n + i];
    }
  }
}

stack *solver_stack_new(const core_isa *isa, const expansion_rules *rules,
                        const stack_layer *layers, size_t count, double below,
                        const atomic_bool *stop) {
  stack *made = calloc(1, sizeof *made);
  if (made == NULL) {
    return NULL;
  }
  *made = (stack){.isa = isa, .count = count, .layers = layers, .stop = stop};
  size_t numbers = 0;
  bool ok = expand(made, rules, below);
  for (size_t i = 0; i < count && ok; i++) {
    const size_t n = made->expanded[i]->n + 1,
                 next = i + 1 < count ? made->expanded[i + 1]->n + 1 : n;
    numbers += numbers_of(n, n) + numbers_of(next, next) + 2 * numbers_of(n, next) +
               2 * numbers_of(next, n) + 4 * n;
  }
  ok = ok && (made->memory = reserve(numbers)) != NULL;
  double *at = made->memory;
  for (size_t i = 0; i + 1 < count && ok; i++) {
    struct step *step = &made->step[i];
    const size_t n = made->expanded[i]->n + 1, next = made->expanded[i + 1]->n + 1;
    step->same = layers[i].index == layers[i + 1].index;
    ok = !solver_stops(stop);
    if (!step->same && ok) {
      step->above = solver_dense_at(isa, &at, n, n, true);
      step->below = solver_dense_at(isa, &at, next, next, true);
      step->down = solver_dense_at(isa, &at, next, n, true);
      step->up = solver_dense_at(isa, &at, n, next, true);
      integrate_step(step, made->expanded[i], made->expanded[i + 1], layers[i].index,
                     layers[i + 1].index);
    }
  }
  for (size_t side = 0; side < SIDES && ok; side++) {
    const size_t i = side == 0 ? 0 : count - 1, n = made->expanded[i]->n + 1;
    made->outer[side] = solver_dense_at(isa, &at, n, n, true);
    made->exit[side] = at;
    at += (n + 7) / 8 * 8;
    if (side == 0 || isfinite(layers[i].thickness)) {
      const size_t boundary = side == 1 ? made->expanded[i]->boundaries.count - 1 : 0;
      note_boundary(made, side, made->expanded[i], boundary,
                    layers[i].index / (side == 0 ? 1 : below));
    }
  }
  for (size_t i = 0; i < count && ok; i++) {
    made->flux[i] = at;
    at += (made->expanded[i]->n + 8) / 8 * 8;
    note_flux(made->expanded[i], made->flux[i]);
  }
  if (!ok) {
    solver_stack_free(made);
    return NULL;
  }
  return made;
}

double solver_stack_cost(const expansion_rules *rules, const stack_layer *layers, size_t count,
                         double below) {
  double edge[EXPANSION_PANELS_MAX - 1], cost = 0;
  for (size_t i = 0; i < count; i++) {
    const size_t panels =
        1 + find_edges(layers, count, below, layers[i].index, rules->upright, edge);
    double n = 0;
    for (size_t m = 0; m <= rules->orders; m++) {
      n += (double)(panels * solver_expansion_degrees(rules, m, panels));
    }
    cost += n * n * n;
  }
  return cost;
}

void solver_stack_free(stack *of) {
  for (size_t i = 0; of != NULL && i < of->count; i++) {
    solver_expansion_free(of->expanded[i]);
  }
  if (of != NULL) {
    free(of->memory);
    free(of);
  }
}

/* ---- one wavenumber ------------------------------------------------------------------------------ */

/* The matrices of a layer and of everything below it. */
struct tower {
  layer_operators own;
  layer_relation whole; /* at the layer's upper face */
  layer_relation below; /* at its lower face; not set for a half space */
  dense reflected;      /* rho at the upper face, under a step where the index changes */
  dense next;           /* Q: from the layer's lower face to the next layer's upper face */
};

/* Columns: light at a head or a foot. */
enum { GROUP = 8, COLUMNS = 4, SPARES = LAYER_SPARE + 1 };

/* Light of one layer that was scattered once or not at all, with a number of reflections. What leaves
 * the layer is kept for the next number. */
struct once {
  dense head_down, foot_up;
  dense foot_down[2], head_up[2];
};

struct work {
  const stack *of;
  bool is_complex;
  struct tower tower[SOLVER_LAYERS_MAX];
  dense spare[SPARES];   /* sized for the largest layer */
  dense column[COLUMNS]; /* sized for the largest layer */
  struct once once[SOLVER_LAYERS_MAX];
};

/* A view of a constant matrix, real if k is. */
static dense view_of(const struct work *by, dense of) {
  of.im = by->is_complex ? of.im : NULL;
  return of;
}

/* Returns a view of the first rows and columns of a spare matrix. */
static dense shaped(dense of, size_t rows, size_t columns) {
  of.rows = rows;
  of.columns = columns;
  of.stride = (columns + GROUP - 1) / GROUP * GROUP;
  return of;
}

static void copy_matrix(const dense *to, const dense *from) {
  solver_dense_combine(to, 1, from, 0, from);
}

static void add_matrix(const dense *to, const dense *from) {
  solver_dense_combine(to, 1, to, 1, from);
}

/* Sets to = (1 - a b)^-1 right. `to` and `right` have one shape; neither may be spare[0]. */
static bool resolve(const struct work *by, const dense *to, const dense *a, const dense *b,
                    const dense *right) {
  const dense left = shaped(by->spare[0], a->rows, a->rows);
  solver_dense_multiply(&left, a, b);
  solver_dense_combine(&left, -1, &left, 0, &left);
  for (size_t i = 0; i < left.rows; i++) {
    left.re[i * left.stride + i] += 1;
  }
  copy_matrix(to, right);
  return solver_dense_solve(&left, to);
}

/* Sets the relation at the upper face of layer i from that at its lower one. */
static bool climb_layer(struct work *by, size_t i) {
  struct tower *here = &by->tower[i];
  layer_relation *whole = &here->whole, *sum = &here->own.sum;
  if (isinf(by->of->layers[i].thickness)) {
    solver_layer_combine(whole, 1, sum, 0, sum);
    return true;
  }
  solver_layer_combine(whole, 0.5, sum, 1, &here->below);
  if (!solver_layer_weigh(by->spare, whole, &here->own.apart, whole)) {
    return false;
  }
  solver_layer_combine(whole, 0.5, sum, -0.25, whole);
  return true;
}

/* Sets the relation at the lower face of layer i, and Q, from what is below it. */
static bool climb_step(struct work *by, size_t i) {
  const stack *of = by->of;
  const struct step *step = &of->step[i];
  struct tower *here = &by->tower[i], *next = here + 1;
  if (i + 1 == of->count) {
    const dense bottom = view_of(by, of->outer[1]);
    return solver_layer_relate(by->spare, of->expanded[i], &here->below, &bottom);
  }
  if (step->same) {
    solver_layer_combine(&here->below, 1, &next->whole, 0, &next->whole);
    return true;
  }
  const dense above = view_of(by, step->above), below = view_of(by, step->below);
  const dense down = view_of(by, step->down), up = view_of(by, step->up);
  const dense *rho = &next->reflected;
  if (!solver_layer_reflect(by->spare, of->expanded[i + 1], rho, &next->whole) ||
      !resolve(by, &here->next, &below, rho, &down)) {
    return false;
  }
  const dense lit = shaped(by->spare[0], rho->rows, up.rows);
  const dense mirrored = shaped(by->spare[LAYER_SPARE], up.rows, up.rows);
  solver_dense_multiply(&lit, rho, &here->next);
  solver_dense_multiply(&mirrored, &up, &lit);
  add_matrix(&mirrored, &above);
  return solver_layer_relate(by->spare, of->expanded[i], &here->below, &mirrored);
}

static double complex product_of(const double *left, const dense *vector, size_t count) {
  double complex sum = 0;
  for (size_t i = 0; i < count; i++) {
    sum += left[i] * solver_dense_get(vector, i, 0);
  }
  return sum;
}

/* Sets *v of a relation, and returns the net flux. */
static double complex net_of(const stack *of, size_t i, const dense *v,
                             const layer_relation *relation, const dense *u) {
  solver_layer_apply(v, of->expanded[i], relation, u);
  return product_of(of->flux[i], v, of->expanded[i]->first[1]) +
         solver_dense_get(v, v->rows - 1, 0);
}

static double corner_of(const dense *of) {
  return of->re[(of->rows - 1) * of->stride + of->columns - 1];
}

/* Sets u at the foot of a layer from that at its head. */
static bool descend_layer(const struct work *by, const struct tower *here, const dense *foot,
                          const dense *head) {
  const layer_relation *sum = &here->own.sum, *apart = &here->own.apart;
  const size_t n = sum->all.rows;
  dense left = shaped(by->spare[0], n, n + 1), column = *foot;
  column.rows = n;
  const double complex beam =
      0.5 * apart->beam / (0.5 * sum->beam + here->below.beam) * solver_dense_get(head, n, 0);
  solver_dense_combine(&left, 0.5, &sum->all, 1, &here->below.all);
  solver_dense_multiply(&column, &apart->all, head);
  solver_dense_combine(&column, 0.5, &column, 0, &column);
  for (size_t row = 0; row < n; row++) {
    solver_dense_put(foot, row, 0,
                     solver_dense_get(&column, row, 0) - solver_dense_get(&left, row, n) * beam);
  }
  solver_dense_put(foot, n, 0, beam);
  left.columns = n;
  return solver_dense_solve(&left, &column);
}

/* Sets what leaves, and the net fluxes. Without light that leaves below, and but for k = 0, the layers
 * below the first one are left out. */
static bool descend(const struct work *by, double complex k, stack_exitance *exitance) {
  const stack *of = by->of;
  const dense top = view_of(by, of->outer[0]), bottom = view_of(by, of->outer[1]);
  const struct tower *first = &by->tower[0];
  const size_t n0 = of->expanded[0]->n;
  const dense lit = shaped(by->column[0], n0, 2);
  if (!solver_layer_light_up(by->spare, of->expanded[0], &lit, &first->whole, 0)) {
    return false;
  }
  const double r0 = corner_of(&top), t = first->whole.beam, rho = (1 - t) / (1 + t);
  const double down = 1 / (1 - r0 * rho), up = rho * down;
  memset(exitance->net, 0, sizeof exitance->net);
  exitance->all[0] = (down + up) * product_of(of->exit[0], &lit, of->expanded[0]->first[1]);
  exitance->beam[0] = (1 - r0) * up;
  exitance->all[1] = exitance->beam[1] = 0;
  if (isinf(of->layers[of->count - 1].thickness) && k != 0) {
    return true;
  }
  dense u = shaped(by->column[1], n0 + 1, 1), back = shaped(by->column[2], n0 + 1, 1);
  for (size_t row = 0; row < n0; row++) {
    solver_dense_put(&back, row, 0, (down + up) * solver_dense_get(&lit, row, 0));
  }
  solver_dense_put(&back, n0, 0, up);
  solver_dense_multiply(&u, &top, &back);
  u.re[n0 * GROUP] += 1;
  add_matrix(&u, &back);
  for (size_t i = 0; i < of->count; i++) {
    const struct tower *here = &by->tower[i];
    const size_t rows = of->expanded[i]->n + 1, n = of->expanded[i]->first[1];
    u = shaped(u, rows, 1);
    const dense v = shaped(by->column[2], rows, 1), foot = shaped(by->column[3], rows, 1);
    exitance->net[i][0] = net_of(of, i, &v, &here->whole, &u);
    if (isinf(of->layers[i].thickness)) {
      return true;
    }
    if (!descend_layer(by, here, &foot, &u)) {
      return false;
    }
    exitance->net[i][1] = net_of(of, i, &v, &here->below, &foot);
    solver_dense_combine(&v, 0.5, &v, 0.5, &foot); /* J+ */
    if (i + 1 == of->count) {
      exitance->all[1] = product_of(of->exit[1], &v, n);
      exitance->beam[1] = (1 - corner_of(&bottom)) * solver_dense_get(&v, rows - 1, 0);
    } else if (of->step[i].same) {
      copy_matrix(&u, &foot);
    } else {
      const dense *mirrored = &here[1].reflected;
      const dense head = shaped(by->column[0], mirrored->rows, 1);
      u = shaped(u, mirrored->rows, 1);
      solver_dense_multiply(&head, &here->next, &v);
      solver_dense_multiply(&u, mirrored, &head);
      add_matrix(&u, &head);
    }
  }
  return true;
}

/* ---- light that was scattered once ----------------------------------------------------------------- */

/* Sets the columns of light at the foot on its way down, or at the head on its way up (`up`), from
 * those that enter the layer. Their beams are in their last rows. */
static void pass_once(const struct work *by, size_t i, const dense *to, const dense *along,
                      const dense *against) {
  const layer_operators *own = &by->tower[i].own;
  const double complex beam = solver_dense_get(against, against->rows - 1, 0);
  if (isinf(by->of->layers[i].thickness)) {
    solver_dense_clear(to);
  } else {
    solver_dense_multiply(to, &own->passed_once, along);
  }
  for (size_t row = 0; row + 1 < to->rows; row++) {
    const double complex more = beam * solver_dense_get(&own->reflected_once, row, 0);
    to->re[row * GROUP] += creal(more);
    if (to->im != NULL) {
      to->im[row * GROUP] += cimag(more);
    }
  }
}

/* Adds a b to `to`. */
static void add_through(const struct work *by, const dense *to, const dense *a, const dense *b) {
  const dense through = view_of(by, *a), more = shaped(by->column[0], to->rows, 1);
  solver_dense_multiply(&more, &through, b);
  add_matrix(to, &more);
}

/* q: the number of reflections; now: which of two columns is of this number. */
static void sweep_down(const struct work *by, size_t q, size_t now) {
  const stack *of = by->of;
  for (size_t i = 0; i < of->count; i++) {
    const struct once *here = &by->once[i];
    const struct step *step = i > 0 ? &of->step[i - 1] : NULL;
    solver_dense_clear(&here->head_down);
    if (i > 0 && step->same) {
      add_matrix(&here->head_down, &by->once[i - 1].foot_down[now]);
    } else if (i > 0) {
      add_through(by, &here->head_down, &step->down, &by->once[i - 1].foot_down[now]);
    }
    if (q > 0 && (i == 0 || !step->same)) {
      add_through(by, &here->head_down, i == 0 ? &of->outer[0] : &step->below,
                  &here->head_up[1 - now]);
    } else if (i == 0) {
      here->head_down.re[(here->head_down.rows - 1) * GROUP] = 1;
    }
    pass_once(by, i, &here->foot_down[now], &here->head_down, &here->foot_up);
  }
}

static void sweep_up(const struct work *by, size_t q, size_t now) {
  const stack *of = by->of;
  for (size_t i = of->count; i-- > 0;) {
    const struct once *here = &by->once[i];
    const bool last = i + 1 == of->count;
    const struct step *step = last ? NULL : &of->step[i];
    solver_dense_clear(&here->foot_up);
    if (!last && step->same) {
      add_matrix(&here->foot_up, &by->once[i + 1].head_up[now]);
    } else if (!last) {
      add_through(by, &here->foot_up, &step->up, &by->once[i + 1].head_up[now]);
    }
    if (q > 0 && !isinf(of->layers[i].thickness) && (last || !step->same)) {
      add_through(by, &here->foot_up, last ? &of->outer[1] : &step->above,
                  &here->foot_down[1 - now]);
    }
    pass_once(by, i, &here->head_up[now], &here->foot_up, &here->head_down);
  }
}

/* Light at a head or a foot is what passes the step there and what the step reflects, which counts as
 * one reflection more. Beams on their way up are known after the second sweep. */
static void scatter_once(const struct work *by, unsigned reflections, stack_exitance *exitance) {
  const stack *of = by->of;
  const size_t last = of->count - 1;
  exitance->once[0] = exitance->once[1] = 0;
  for (size_t q = 0; q <= reflections; q++) {
    const size_t now = q % 2;
    for (size_t i = 0; i < of->count; i++) {
      solver_dense_clear(&by->once[i].foot_up);
    }
    sweep_down(by, q, now);
    sweep_up(by, q, now);
    sweep_down(by, q, now);
    exitance->once[0] +=
        product_of(of->exit[0], &by->once[0].head_up[now], of->expanded[0]->first[1]);
    exitance->once[1] +=
        isinf(of->layers[last].thickness)
            ? 0
            : product_of(of->exit[1], &by->once[last].foot_down[now], of->expanded[last]->first[1]);
  }
}

/* ---- the whole stack ------------------------------------------------------------------------------- */

/* Returns how many numbers lay_out() needs for one wavenumber. */
static size_t numbers_for(const stack *of) {
  enum { SQUARES = 7, COLUMNS_OF_LAYER = 7 };
  size_t most = 0, numbers = 0;
  for (size_t i = 0; i < of->count; i++) {
    const size_t n = of->expanded[i]->n + 1;
    most = n > most ? n : most;
  }
  numbers += (SQUARES * of->count + SPARES) * numbers_of(most, most);
  return numbers + (COLUMNS_OF_LAYER * of->count + COLUMNS) * numbers_of(most, 1);
}

/* Places the matrices in memory from `at` on. */
static void lay_out(struct work *to, const stack *of, double *at) {
  size_t most = 0;
  for (size_t i = 0; i < of->count; i++) {
    struct tower *here = &to->tower[i];
    struct once *once = &to->once[i];
    const size_t n = of->expanded[i]->n + 1;
    const size_t next = i + 1 < of->count ? of->expanded[i + 1]->n + 1 : n;
    dense *const square[] = {&here->own.passed_once, &here->reflected};
    dense *const related[] = {&here->own.sum.all, &here->own.apart.all, &here->whole.all,
                              &here->below.all};
    dense *const column[] = {&here->own.reflected_once, &once->head_down,    &once->foot_up,
                             &once->foot_down[0],       &once->foot_down[1], &once->head_up[0],
                             &once->head_up[1]};
    for (size_t j = 0; j < sizeof square / sizeof *square; j++) {
      *square[j] = solver_dense_at(of->isa, &at, n, n, to->is_complex);
    }
    for (size_t j = 0; j < sizeof related / sizeof *related; j++) {
      *related[j] = solver_dense_at(of->isa, &at, n - 1, n, to->is_complex);
    }
    for (size_t j = 0; j < sizeof column / sizeof *column; j++) {
      *column[j] = solver_dense_at(of->isa, &at, n, 1, to->is_complex);
    }
    here->next = solver_dense_at(of->isa, &at, next, n, to->is_complex);
    most = n > most ? n : most;
  }
  for (size_t i = 0; i < sizeof to->spare / sizeof *to->spare; i++) {
    to->spare[i] = solver_dense_at(of->isa, &at, most, most, to->is_complex);
  }
  for (size_t i = 0; i < COLUMNS; i++) {
    to->column[i] = solver_dense_at(of->isa, &at, most, 1, to->is_complex);
  }
}

bool solver_stack_at(const stack *of, double complex k, unsigned reflections,
                     stack_exitance *exitance) {
  struct work *work = calloc(1, sizeof *work);
  double *memory = NULL;
  bool ok = work != NULL;
  if (ok) {
    *work = (struct work){.of = of, .is_complex = cimag(k) != 0};
    memory = reserve(numbers_for(of));
    ok = memory != NULL;
  }
  if (ok) {
    lay_out(work, of, memory);
  }
  for (size_t i = of->count; i-- > 0 && ok;) {
    const stack_layer *layer = &of->layers[i];
    const double unit = 1 / layer->extinction;
    ok = solver_layer_operators(&work->tower[i].own, of->expanded[i], k * unit, layer->kappa * unit,
                                layer->thickness * layer->extinction, of->stop);
    ok = ok && (isinf(layer->thickness) || climb_step(work, i)) && climb_layer(work, i);
  }
  ok = ok && descend(work, k, exitance);
  if (ok) {
    scatter_once(work, reflections, exitance);
  }
  free(memory);
  free(work);
  return ok;
}

bool solver_stack_halfspace(const stack *of, size_t i, double complex k, double complex *exitance) {
  const stack_layer *layer = &of->layers[i];
  const double unit = 1 / layer->extinction;
  layer_exitance found[2];
  const bool ok = solver_layer_halfspace(of->expanded[i], k * unit, layer->kappa * unit, found);
  *exitance = ok ? found[0].part[0] : 0;
  return ok;
}
