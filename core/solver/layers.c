/* R and T of layers: see solver.c for the way from wavenumbers to radii, stack.c for one wavenumber
 * and ways.c for light that was scattered once. Lengths are in scaled mean free paths of the first
 * layer. */
#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/solver/layer.h"
#include "core/solver/solver.h"
#include "core/solver/stack.h"
#include "core/solver/ways.h"
#include "core/transport/decay.h"
#include "core/transport/functions.h"

enum { SIDES = SOLVER_SIDES, GRIDS = 2 };

/* The reduced mean free paths of the first layer from where on a tolerance is kept, and up to which
 * R and T are known. */
#define RADIUS_COUNTS 0.05
#define RADIUS_MOST 1e3

/* Grids for layers. Functions of an even number of degrees, order 0 that is, are the better ones:
 * beyond k = 5 those of odd numbers are off by up to 10 times as much, and the other way. */
enum { LEVELS = 5 };
static const struct level levels[LEVELS] = {
    {1e-3,
     24,
     {3e-3, 2e-3},
     0.7,
     6,
     {{0.3, {3, 6, 3}}, {1, {3, 6, 3}}, {3, {4, 8, 3}}, {3.5, {4, 8, 3}}}},
    {1e-4,
     30,
     {2e-3, 1e-3},
     0.7,
     7,
     {{0.3, {3, 8, 3}}, {1, {4, 8, 3}}, {3, {6, 10, 3}}, {4.5, {6, 10, 4}}}},
    {1e-4,
     40,
     {1.2e-3, 3e-4},
     0.85,
     8,
     {{0.3, {4, 8, 3}}, {1, {6, 10, 3}}, {3, {8, 12, 4}}, {5, {8, 14, 5}}}},
    {1e-4,
     48,
     {8e-4, 1.6e-4},
     0.85,
     8,
     {{0.3, {4, 10, 3}}, {1, {6, 12, 4}}, {3, {8, 14, 4}}, {6.5, {8, 16, 5}}}},
    {1e-5,
     64,
     {4e-4, 8e-5},
     0.85,
     9,
     {{0.3, {5, 10, 4}}, {1, {7, 12, 4}}, {3, {10, 18, 6}}, {7.5, {10, 20, 6}}}},
};

/* At most so many grids are solved, and the next one only if those that are left promise to reach the
 * tolerance of R or of T: each is up to so many times as good as the one before. A still finer one
 * would have wavenumbers of T beyond its digits. */
enum { GRIDS_MOST = 4 };
#define GAIN 4.0

/* Layers of less depth start from the finer grids: coarse ones find no digit of R. */
#define THIN_FINE 1.0

/* Stated errors over the grids' difference. Grids share their errors more than those of a half
 * space: of 80 random stacks, R was off by up to 4.4 times the difference, and by 5.1 times far from
 * the beam where no layer is a half space. */
#define MARGIN 5.0
#define MARGIN_FINITE 6.0

/* So many times more for T where a layer has less than WEAK of the largest extinction. */
#define WEAK 0.1
#define WEAK_MARGIN 2.0

/* A layer of less depth does not cut off enough of its phase function to count. */
#define CUT_DEPTH 0.02

/* X on the path is known as well as this part of the floor far away, relative. Where its
 * contributions cancel, far from the beam and in T of slabs that let nearly nothing through, it
 * counts more. What is smaller by DIGITS than 1 per squared reduced mean free path is not known. */
#define PATH_ERROR 0.01
#define DIGITS 2e-19

#define NEARER 1.2

/* One grid. */
struct grid {
  bool backward; /* whether a layer scatters back (solver_is_backward()) */
  double moment[SOLVER_LAYERS_MAX][EXPANSION_MOMENTS_MAX];
  stack_layer layer[SOLVER_LAYERS_MAX];
  ways ways;
  double unit_mm; /* scaled mean free path of the first layer */
  double rate;    /* decay rate of light far away along the layers, per unit */
  size_t like;    /* layer of which a half space is like the layers near the beam; count: none */
  double layered_most;              /* the largest k at which R is not that of this half space */
  double share;                     /* Im k over it where the path of wavenumbers starts */
  exitance_grid wavenumbers[SIDES]; /* one may have further panels */
  double passes;   /* what counts of light below that was scattered once, see pass_onwards() */
  double guess[3]; /* of T: k from where on it is guessed, or 0, Im k there, the error of k^2 T */
  exitance_series exitance[SIDES];
};

struct solver_layers {
  size_t count, sides;
  solver_layer layer[SOLVER_LAYERS_MAX];
  double eta_below;
  double radius_mm;         /* reduced mean free path of the first layer */
  struct grid *grid[GRIDS]; /* [0]: the finest grid; [1]: the next coarser one */
  const double *floor;      /* least relative errors: next to the source, and far away */
  double error[SIDES][SOLVER_ERROR_RADII];
  size_t last; /* index of the last of these radii where light has not decayed by e^-DECAYS_MOST */
};

/* ---- the medium ---------------------------------------------------------------------------- */

static void truncate_layers(struct grid *to, const struct solver_layers *of, double moment_least,
                            size_t moments_most, size_t degrees) {
  solver_phase phase = {.g = 0};
  for (size_t i = 0; i < of->count; i++) {
    phase.g = fmax(phase.g, fabs(of->layer[i].g));
  }
  const size_t moments = solver_moments_kept(&phase, moment_least, moments_most, degrees);
  for (size_t i = 0; i < of->count; i++) {
    const solver_layer *layer = &of->layer[i];
    const double sigma_t = layer->sigma_a_per_mm + layer->sigma_s_per_mm;
    stack_layer *here = &to->layer[i];
    phase.g = layer->g;
    const bool backward = solver_is_backward(&phase);
    const size_t kept =
        backward ? solver_moments_kept(&phase, moment_least, moments_most, degrees) : moments;
    to->backward |= backward;
    const double scaled = sigma_t * solver_truncate(&here->medium, to->moment[i], &phase, kept,
                                                    layer->sigma_s_per_mm / sigma_t);
    to->unit_mm = i == 0 ? 1 / scaled : to->unit_mm;
    here->extinction = scaled * to->unit_mm;
    here->sigma_s = layer->sigma_s_per_mm * to->unit_mm;
    here->g = layer->g;
    here->thickness = layer->thickness_mm / to->unit_mm;
    here->index = layer->eta;
    here->kappa = here->extinction * transport_decay_rate(to->moment[i], kept, here->medium.albedo,
                                                          here->medium.reversed,
                                                          layer->sigma_a_per_mm / scaled);
  }
  solver_ways_find(&to->ways, to->layer, of->count, of->eta_below);
}

/* ---- decay far away ------------------------------------------------------------------------ */

/* Sets *rate to the rate of decay along the layers: X = int R(r) J0(kr) ... rises along k = iq up to its
 * first pole, which few functions of angle have at nearly the same place. Guided light in a thin slab
 * decays at a third of the rate of diffusion theory. Returns false if memory runs out. */
static bool find_rate(struct grid *to, const struct solver_layers *of, const core_isa *isa,
                      const atomic_bool *stop) {
  static const expansion_rules rules = {2, 6, 3};
  static const double step = 1.1;
  enum { HALVINGS = 4 };
  const size_t last = of->count - 1;
  double most = isinf(to->layer[last].thickness) ? to->layer[last].kappa : 1, depth = 5;
  for (size_t i = 0; i < of->count; i++) {
    most = fmin(most, 0.8 * to->layer[i].extinction);
    depth += isinf(to->layer[i].thickness) ? 0 : to->layer[i].extinction * to->layer[i].thickness;
  }
  to->rate = most;
  stack *expanded = solver_stack_new(isa, &rules, to->layer, of->count, of->eta_below, stop);
  bool ok = expanded != NULL;
  stack_exitance at;
  double before = 0, below = 0;
  for (double q = 0.1 / depth; q < step * most && ok && to->rate == most; q *= step) {
    ok = solver_stack_at(expanded, CMPLX(0, fmin(q, most * (1 - 1e-6))), 0, &at);
    if (creal(at.all[0]) > before) {
      before = creal(at.all[0]);
      below = q;
      continue;
    }
    double above = q;
    for (size_t i = 0; i < HALVINGS && ok; i++) {
      const double middle = 0.5 * (below + above);
      ok = solver_stack_at(expanded, CMPLX(0, middle), 0, &at);
      *(creal(at.all[0]) > before ? &below : &above) = middle;
    }
    to->rate = below;
  }
  solver_stack_free(expanded);
  return ok;
}

/* ---- one grid ------------------------------------------------------------------------------ */

/* Where no layer is like a half space: scaled mean free paths below which a first layer is thin, and
 * all layers of finite depth. Largest k of T over the scaled extinction that the functions of angle
 * resolve in a layer that light crosses, and in the last one. R goes on to RESOLVED_ABOVE times that,
 * as little of its light crosses such layers, and with fewer degrees to less: grids that end at the
 * same k would guess alike beyond. */
#define THIN 2.0
#define THIN_ALL 5.0
#define RESOLVED 20
#define RESOLVED_LAST 54
#define RESOLVED_ABOVE 4.0
#define RESOLVED_DEGREES 16.0

/* A layer of this depth or more, below a film at most, is like a half space: X differs by less than
 * about e^(-k depth), which goes on as from k = like_most / depth. Below LIKE_FROM, relative to
 * its extinction, all functions of angle are as good. The half space's are of the first level that
 * is for LIKE_FINE times its largest k. Under a film X differs by 1 % at k of 9 to 18 still: the
 * finer grids end at different k, as they would guess alike beyond. */
#define LIKE_DEPTH 0.5
#define LIKE_DEPTH_ENDS 1.5
#define FILM_DEPTH 0.1
#define LIKE_FROM 1.0
static const double like_most[LEVELS] = {8, 8, 8, 10, 12};
#define LIKE_FINE 0.7

/* Over a half space, which absorbs, the path rises so many times as far as that of one layer: R far
 * from the beam then has less of the errors of large k, by up to a factor of 50. Where Im k is more
 * than 0.5 to 0.7 of the least extinction, a rate of the functions of angle changes its sign, and X is
 * off by up to its size; with 1.4 it is 0.49. Slabs lose digits of T near the axis. */
#define RISES 1.4

/* From a level on, slabs, which light leaves at grazing angles, have more functions of angle, and a
 * wavenumber more on each panel. */
enum { MORE_FROM = 2, MORE_DEGREES = 2 };

/* Layers of three indices have few degrees between their critical angles. At large wavenumbers light within
 * an angle of 1 / k of the beam is another one than beside it: panels meet there, too, from the same
 * level on. The finest grid then takes too long. */
#define UPRIGHT 0.955
enum { UPRIGHT_DEGREES = 4 };

/* Im k over the rate where their path starts then: their rate is a pole of their own X. */
#define SHARE_FINITE 0.87

#define NOISE_BELOW 0.9
#define NOISE_RISES 1.3
#define NOISE_FROM 2.0
enum { NOISE_NODES = 2 };

/* Light that is deflected little, see pass_onwards(), and T agree within NOISE_ONWARDS before noise
 * begins, and the error of the former beyond is UNSURE or less. It counts from ONWARDS_LEAST times the
 * largest k^2 T on, and where the mean depth of a wave is below 1 if T is up to ONWARDS_COUNTS times
 * as large. T's wavenumbers go on to ONWARDS_MOST times that at which as much is scattered once as
 * not. What T has beside it is fitted from FITTED_FROM of the last wavenumber on, and falls at least
 * as k^-FALLS_LEAST there. */
#define NOISE_ONWARDS 0.15
#define UNSURE 0.05
#define ONWARDS_LEAST 0.02
#define ONWARDS_COUNTS 2
#define ONWARDS_MOST 3
#define FITTED_FROM 0.4
#define FALLS_LEAST 2
#define BEAM_LEAST 1e-200
#define ONWARDS_DIGITS 1e3 /* times T at most, so that their difference keeps T's digits */
#define PATH_RATE_LEAST 1e-9

/* Over this, the last wavenumbers of R and of T are the same. */
#define LAST_ALIKE (1 - 1e-6)

/* Returns whether there are layers of three indices or more. */
static bool has_indices(const struct solver_layers *of) {
  double other = of->layer[0].eta;
  for (size_t i = 1; i < of->count; i++) {
    const double eta = of->layer[i].eta;
    if (eta != of->layer[0].eta && other != of->layer[0].eta && eta != other) {
      return true;
    }
    other = eta != of->layer[0].eta ? eta : other;
  }
  return false;
}

/* Returns the optical depth of layer `first`, including adjacent layers with the same medium. */
static double depth_from(const struct grid *of, const struct solver_layers *all, size_t first) {
  const solver_layer *top = &all->layer[first];
  double depth = 0;
  for (size_t i = first; i < all->count; i++) {
    const solver_layer *here = &all->layer[i];
    if (here->sigma_a_per_mm != top->sigma_a_per_mm ||
        here->sigma_s_per_mm != top->sigma_s_per_mm || here->g != top->g || here->eta != top->eta) {
      break;
    }
    depth += of->layer[i].extinction * of->layer[i].thickness;
  }
  return depth;
}

/* Returns the first layer that is LIKE_DEPTH deep or more (LIKE_DEPTH_ENDS where light is reflected
 * below), if those above are a film of the same index and no more extinction, in which light is
 * scattered back from nearer; else the number of layers. */
static size_t find_like(const struct grid *of, const struct solver_layers *all) {
  double above = 0;
  for (size_t i = 0; i < all->count && above < FILM_DEPTH && all->layer[i].eta == all->layer[0].eta;
       i++) {
    const size_t last = all->count - 1;
    const bool ends =
        all->layer[last].eta != all->layer[0].eta || isfinite(of->layer[last].thickness);
    if (depth_from(of, all, i) >= (ends ? LIKE_DEPTH_ENDS : LIKE_DEPTH)) {
      return i == 0 || of->layer[i].extinction >= 1 ? i : all->count;
    }
    above += of->layer[i].extinction * of->layer[i].thickness;
  }
  return all->count;
}

/* Adds panels up to k = last, which double in width where they all have room. */
static void extend_wavenumbers(exitance_grid *to, double last) {
  double *end = &to->tier_end[TIERS - 1];
  const double room = (double)(EXITANCE_PANELS_MAX - to->panels);
  const double wider = fmax(2, fn_exp(fn_log(last / *end) / room) * (1 + 1e-9));
  while (*end < LAST_ALIKE * last) {
    const double next = wider * *end;
    *end = next > 0.7 * last ? last : next;
    assert(to->panels < EXITANCE_PANELS_MAX);
    to->point[to->panels + 1] = CMPLX(*end, cimag(to->point[to->panels]));
    to->panels++;
  }
}

static bool place_wavenumbers(struct grid *to, const struct solver_layers *of, const core_isa *isa,
                              const struct level *by, const atomic_bool *stop) {
  double least = 1, all_least = 1, depth = 0, resolved = (double)INFINITY;
  for (size_t i = 0; i < of->count; i++) {
    const double s = to->layer[i].extinction;
    all_least = fmin(all_least, s);
    if (i == 0 || (2 * depth < 7 && s * to->layer[i].thickness > 0.02)) {
      const double thick = fmin(1, s * to->layer[i].thickness);
      resolved = fmin(resolved, (i + 1 == of->count ? RESOLVED_LAST : RESOLVED) * s / thick);
      least = fmin(least, s);
    }
    depth += s * to->layer[i].thickness;
  }
  const double most = by->tier[TIERS - 1].k_most;
  /* Where the first layer is thin, or all together are, X reaches its limit later: at some 14 over the
   * thickness, as far as the functions of angle resolve how light is scattered. */
  const double first = depth_from(to, of, 0);
  const double round = 1 - fabs(to->layer[0].g);
  const double thin =
      first < THIN || depth < THIN_ALL ? THIN * (1 + round * round * (1 / fmin(1, first) - 1)) : 1;
  const double finer = (double)by->tier[TIERS - 1].rules.degrees / RESOLVED_DEGREES;
  double last_above = fmin(fmax(4, thin * most), finer * fmax(4, RESOLVED_ABOVE * resolved));
  double last = fmax(4, fmin(resolved, thin * most));
  to->layered_most = last_above;
  to->like = to->backward ? of->count : find_like(to, of);
  if (to->like < of->count) {
    const double s = to->layer[to->like].extinction;
    const double alike = fmin(last_above, fmax(s, like_most[by - levels] * s / first));
    last_above = most * s;
    if (to->like == 0) {
      to->layered_most = first < 1 ? alike : fmin(alike, most * s);
      last_above = first < 1 || by < &levels[MORE_FROM] ? fmax(last_above, alike) : last_above;
    }
    last = fmax(last, last_above);
  }
  last = of->sides > 1 ? last : last_above;
  double end[TIERS];
  for (size_t tier = 0; tier < TIERS; tier++) {
    end[tier] = tier + 1 == TIERS
                    ? fmin(last, last_above)
                    : fmin(by->tier[tier].k_most * (of->sides > 1 ? all_least : least), last);
  }
  if (!find_rate(to, of, isa, stop)) {
    return false;
  }
  to->rate = to->rate < PATH_RATE_LEAST ? 0 : to->rate;
  /* R's panels end where R needs no more, T's at the same k or another one: K, whose error grids of
   * the same K share, is another one on each grid. */
  exitance_grid *above = &to->wavenumbers[0], *below = &to->wavenumbers[1];
  const double rises = of->sides == 1 && to->rate > 0 ? RISES : 1;
  const double share = of->sides > 1 && by >= &levels[MORE_FROM] ? SHARE_FINITE : by->share;
  const size_t nodes = by->nodes + (of->sides > 1 && by >= &levels[MORE_FROM]);
  solver_exitance_place(above, NULL, to->rate, share, rises * all_least, nodes, end);
  *below = *above;
  extend_wavenumbers(above, last_above);
  extend_wavenumbers(below, last);
  return true;
}

/* Returns the beam at the foot of the last layer; 0 for a half space. */
static double arriving_beam(const ways *of) {
  const stack_layer *last = &of->layer[of->layers - 1];
  return of->down[of->layers - 1][of->reflections_most] *
         fn_exp(-last->extinction * last->thickness);
}

/* Sets onwards[] to light that is deflected little each time it is scattered, and more than once: what
 * leaves has passed e^x times as much as the beam, where x of it is scattered once. `far`, the limit of
 * k^2 T, replaces that of what is scattered twice. What of a phase function counts as unscattered is
 * so neither near the beam: to->passes is set to the part of the beam that is left without it, and the
 * light that it scatters once beyond that is added to T[]. T's wavenumbers go on, if there is room, to
 * where little is scattered more than twice. */
static void pass_onwards(struct grid *to, const struct solver_layers *all, double far,
                         double complex *onwards, double complex *T, const atomic_bool *stop) {
  exitance_grid *grid = &to->wavenumbers[1];
  const stack_layer *last = &to->layer[all->count - 1];
  const double beam =
      arriving_beam(&to->ways) * (1 - solver_beam_reflectance(last->index, all->eta_below));
  double peak = 0;
  for (size_t i = 0; i < all->count; i++) {
    const solver_layer *layer = &all->layer[i];
    peak += layer->thickness_mm * (layer->sigma_a_per_mm + layer->sigma_s_per_mm) -
            to->layer[i].thickness * to->layer[i].extinction;
  }
  to->passes = fn_exp(-peak);
  if (beam < BEAM_LEAST) {
    return;
  }
  const double limit = creal(solver_ways_onwards(&to->ways, (double)INFINITY));
  const double twice = far - 0.5 * beam * limit * limit;
  const size_t solved = grid->panels * grid->nodes;
  double most = 0;
  for (size_t node = 0; node < solved; node++) {
    most = fmax(most, fn_norm2(solver_exitance_wavenumber(grid, node)) * fn_abs(T[node]));
  }
  while (grid->panels < EXITANCE_PANELS_MAX &&
         creal(grid->point[grid->panels]) < ONWARDS_MOST * limit) {
    const double complex end = grid->point[grid->panels];
    grid->point[++grid->panels] = CMPLX(2 * creal(end), cimag(end));
  }
  for (size_t node = 0; node < grid->panels * grid->nodes && !solver_stops(stop); node++) {
    const double complex k = solver_exitance_wavenumber(grid, node);
    const double complex x = solver_ways_onwards(&to->ways, k);
    onwards[node] = to->passes * (beam * (fn_cexp(x) - 1 - x) + twice * fn_inverse(1 + k * k));
    T[node] += (1 - to->passes) * beam * x;
  }
  to->guess[2] =
      fn_norm2(solver_exitance_wavenumber(grid, solved - 1)) * fn_abs(onwards[solved - 1]);
  if (to->guess[2] < ONWARDS_LEAST * most) {
    grid->panels = solved / grid->nodes;
    memset(onwards, 0, solved * sizeof *onwards);
  }
  for (size_t node = 0; node < solved; node++) {
    /* small wavenumbers of thick layers */
    const bool is_most = !(fn_abs(onwards[node]) <= ONWARDS_DIGITS * fn_abs(T[node]));
    onwards[node] = is_most ? 0 : onwards[node];
    T[node] -= onwards[node];
  }
}

/* Returns what T - onwards is at a node, where k_last is the last wavenumber known. */
static double complex like_onwards(const double complex like[2], const exitance_grid *all,
                                   size_t node, double complex k_last,
                                   const double complex *onwards) {
  const double complex ratio = k_last * fn_inverse(solver_exitance_wavenumber(all, node));
  return ratio * (like[0] + like[1] * ratio) * onwards[node];
}

/* Fits like_onwards() by least squares to nodes of the last wavenumbers. T: without `onwards`. */
static void fit_onwards(const exitance_grid *all, size_t last, const double complex *onwards,
                        const double complex *T, double complex like[2]) {
  const double complex k_last = solver_exitance_wavenumber(all, last);
  double complex mixed = 0, right[2] = {0};
  double square[2] = {0};
  for (size_t node = last + 1; node-- > 0;) {
    const double complex k = solver_exitance_wavenumber(all, node);
    if (creal(k) < FITTED_FROM * creal(k_last)) {
      break;
    }
    const double complex ratio = k_last * fn_inverse(k);
    const double complex one = ratio * onwards[node], two = ratio * one;
    square[0] += fn_norm2(one);
    square[1] += fn_norm2(two);
    mixed += conj(one) * two;
    right[0] += conj(one) * T[node];
    right[1] += conj(two) * T[node];
  }
  const double determinant = square[0] * square[1] - fn_norm2(mixed);
  if (determinant > 0) {
    like[0] = (square[1] * right[0] - mixed * right[1]) / determinant;
    like[1] = (square[0] * right[1] - conj(mixed) * right[0]) / determinant;
  }
}

/* k^2 T falls from its peak on, where it crosses thick layers as e^(-k thickness). Where it rises
 * again, it is smaller than what the functions of angle do not resolve: it falls on as before from
 * there, or from the last of `solved` nodes. Below NOISE_FROM over the thickness, the pole of light far
 * away has k^2 T fall and rise. T: without `onwards`, which has no noise and is added. */
static void cut_noise(struct grid *to, double thickness, double depth, size_t solved,
                      const double complex *onwards, double complex *T) {
  exitance_grid *all = &to->wavenumbers[1];
  double most = 0, least = 0;
  size_t at = 0;
  bool rises = false, fell = false;
  for (size_t node = 0; node < solved && !rises; node++) {
    const double complex k = solver_exitance_wavenumber(all, node);
    const double size = fn_abs(T[node]) * fn_norm2(k);
    const double known = NOISE_ONWARDS * fn_abs(onwards[node]) * fn_norm2(k);
    const double crossed = creal(k) * thickness;
    const bool first =
        crossed < NOISE_FROM || (crossed < depth && NOISE_ONWARDS * size < ONWARDS_COUNTS * known);
    fell = !first && (fell || least < NOISE_BELOW * most || size < known);
    rises = fell && least > 0 && size > NOISE_RISES * fmax(least, known);
    most = first ? size : fmax(most, size);
    if (!fell || size <= fmax(least, known)) {
      least = size;
      at = node;
    }
  }
  if (rises || fn_abs(T[solved - 1]) < fn_abs(onwards[solved - 1])) {
    /* The least values have noise in them. */
    const size_t last = !rises ? solved - 1 : at < 2 * NOISE_NODES ? at : at - NOISE_NODES;
    const size_t before = last < NOISE_NODES ? 0 : last - NOISE_NODES;
    const double complex k = solver_exitance_wavenumber(all, last);
    const double complex way = k - solver_exitance_wavenumber(all, before);
    double complex like[2] = {0, 0};
    if (fn_abs(T[last]) < fn_abs(onwards[last])) {
      fit_onwards(all, last, onwards, T, like);
    }
    const double complex here = T[last] - like_onwards(like, all, last, k, onwards);
    const double complex there = T[before] - like_onwards(like, all, before, k, onwards);
    const double falls =
        fmax(creal(fn_clog(there * fn_inverse(here)) * fn_inverse(way)), FALLS_LEAST / creal(k));
    to->guess[0] = creal(k);
    to->guess[1] = cimag(k);
    to->guess[2] = (onwards[last] == 0 ? to->guess[2] : 0) +
                   fn_norm2(k) * (UNSURE * fn_abs(onwards[last]) + fn_abs(T[last] - here)) +
                   creal(k) / falls * fn_abs(here);
    for (size_t node = last + 1; node < all->panels * all->nodes; node++) {
      T[node] = here * fn_cexp(-falls * (solver_exitance_wavenumber(all, node) - k)) +
                like_onwards(like, all, node, k, onwards);
    }
  } else {
    all->panels = solved / all->nodes;
  }
  all->tier_end[TIERS - 1] = creal(all->point[all->panels]);
  for (size_t node = 0; node < all->panels * all->nodes; node++) {
    T[node] += onwards[node];
  }
}

/* Near the beam, light in layers is that of a half space, which more functions of angle resolve than
 * all layers. Sets *like to its exitance, and corrects *value, that of the layers, where they were
 * solved; else sets it. */
static bool make_like(const struct grid *of, const stack *expanded, const expansion *fine,
                      double complex k, bool layered, double complex *like, double complex *value) {
  const stack_layer *layer = &of->layer[of->like];
  const double unit = 1 / layer->extinction;
  layer_exitance found;
  double complex coarse = 0;
  const bool ok = solver_layer_halfspace(fine, k * unit, layer->kappa * unit, &found) &&
                  (!layered || solver_stack_halfspace(expanded, of->like, k, &coarse));
  *like = found.part[0];
  *value = *like + (layered ? *value - coarse : 0);
  return ok;
}

/* Returns the grid of R or T that has all wavenumbers of both. */
static const exitance_grid *all_wavenumbers(const struct grid *of) {
  return &of->wavenumbers[of->wavenumbers[1].panels > of->wavenumbers[0].panels ? 1 : 0];
}

/* Returns whether a node's panel is one where the layers are like a half space, and its wavenumber at
 * least `from`. */
static bool is_alike(const struct grid *of, const struct solver_layers *all, size_t node,
                     double from) {
  const exitance_grid *at = all_wavenumbers(of);
  return of->like < all->count &&
         creal(at->point[node / at->nodes]) >= LIKE_FROM * of->layer[of->like].extinction &&
         creal(solver_exitance_wavenumber(at, node)) >= from;
}

/* What is left of layers' X - that of the half space, `from` at the wavenumber k_from, at k: light that
 * comes from below a depth falls as e^(-k depth) / k^2. */
static double complex leave_like(double complex from, double complex k_from, double complex k,
                                 double depth) {
  const double complex ratio = k_from * fn_inverse(k);
  return isinf(depth) ? 0 : from * ratio * ratio * fn_cexp(-depth * (k - k_from));
}

static expansion_rules rules_of(const struct grid *of, const struct solver_layers *all,
                                const struct level *by, size_t tier) {
  expansion_rules rules = solver_rules_at(by, tier, of->backward);
  rules.degrees += all->sides > 1 && by >= &levels[MORE_FROM] ? MORE_DEGREES : 0;
  if (tier + 1 == TIERS && by >= &levels[MORE_FROM] && has_indices(all)) {
    rules.upright = UPRIGHT;
    rules.degrees += UPRIGHT_DEGREES;
  }
  return rules;
}

/* Solves the wavenumbers that belong to one tier. values: [SIDES + 1][nodes], of which the last are
 * of the half space. */
static bool solve_tier(const struct grid *of, const struct solver_layers *all, const core_isa *isa,
                       const struct level *by, size_t tier, double complex *values, size_t nodes,
                       const atomic_bool *stop) {
  const exitance_grid *wavenumbers = all_wavenumbers(of);
  const struct level *fine_by = &solver_levels[by - levels];
  const double last_above = creal(of->wavenumbers[0].point[of->wavenumbers[0].panels]);
  while (of->like < all->count && fine_by < &solver_levels[SOLVER_LEVELS - 1] &&
         fine_by->tier[TIERS - 1].k_most * of->layer[of->like].extinction <
             LIKE_FINE * last_above) {
    fine_by++;
  }
  const expansion_boundaries boundary = {.count = 1, .etas = &of->layer[0].index};
  const expansion_rules rules = rules_of(of, all, by, tier);
  const expansion_rules fine_rules = solver_rules_at(fine_by, tier, of->backward);
  stack *expanded = NULL;
  expansion *fine = NULL;
  double complex *like = values + SIDES * nodes;
  const double depth = depth_from(of, all, 0);
  size_t edge = 0; /* the first node where R's layers are not solved */
  while (edge < solver_exitance_end(wavenumbers, TIERS - 1) &&
         !is_alike(of, all, edge, of->layered_most)) {
    edge++;
  }
  bool ok = true;
  for (size_t node = tier == 0 ? 0 : solver_exitance_end(wavenumbers, tier - 1);
       node < solver_exitance_end(wavenumbers, tier) && ok; node++) {
    const double complex k = solver_exitance_wavenumber(wavenumbers, node);
    const bool layered = node < edge;
    ok = !solver_stops(stop);
    if (ok && (layered || all->sides > 1)) {
      stack_exitance at;
      expanded = expanded != NULL
                     ? expanded
                     : solver_stack_new(isa, &rules, of->layer, all->count, all->eta_below, stop);
      ok = expanded != NULL && solver_stack_at(expanded, k, of->ways.reflections_most, &at);
      for (size_t side = 0; side < SIDES && ok; side++) {
        const bool known = node < solver_exitance_end(&of->wavenumbers[side], TIERS - 1);
        values[side * nodes + node] = known ? at.all[side] - at.once[side] : 0;
      }
      like[node] = values[node];
    }
    if (ok && is_alike(of, all, node, 0) &&
        node < solver_exitance_end(&of->wavenumbers[0], TIERS - 1)) {
      fine = fine != NULL
                 ? fine
                 : solver_expansion_new(isa, &fine_rules, &of->layer[of->like].medium, &boundary);
      ok = fine != NULL && make_like(of, expanded, fine, k, layered, &like[node], &values[node]);
      if (!layered) {
        values[node] += leave_like(values[edge - 1] - like[edge - 1],
                                   solver_exitance_wavenumber(wavenumbers, edge - 1), k, depth);
      }
    }
  }
  solver_stack_free(expanded);
  solver_expansion_free(fine);
  return ok;
}

/* Returns what solving a grid whose wavenumbers are placed takes: some 3e8 a second with AVX-512. */
static double cost_of(const struct grid *of, const struct solver_layers *all,
                      const struct level *by) {
  double cost = 0;
  for (size_t tier = 0, done = 0; tier < TIERS; tier++) {
    const expansion_rules rules = rules_of(of, all, by, tier);
    const size_t end = solver_exitance_end(all_wavenumbers(of), tier);
    cost += (double)(end - done) * solver_stack_cost(&rules, of->layer, all->count, all->eta_below);
    done = end;
  }
  return cost;
}

/* cost: the largest that a grid may have; infinite if this one has more. */
static bool solve_grid(struct grid *to, const struct solver_layers *of, const core_isa *isa,
                       const struct level *by, double *cost, const atomic_bool *stop) {
  truncate_layers(to, of, by->moment_least, by->moments_most, by->tier[TIERS - 1].rules.degrees);
  if (!place_wavenumbers(to, of, isa, by, stop)) {
    return false;
  }
  if (cost_of(to, of, by) > *cost) {
    *cost = (double)INFINITY;
    return false;
  }
  enum { nodes = EXITANCE_PANELS_MAX * EXITANCE_NODES_MAX };
  double complex *values = calloc((SIDES + 1) * nodes, sizeof *values);
  bool ok = values != NULL;
  for (size_t tier = 0; tier < TIERS && ok; tier++) {
    ok = solve_tier(to, of, isa, by, tier, values, nodes, stop);
  }
  double thickness = 0, depth = 0;
  for (size_t i = 0; i < of->count; i++) {
    thickness += to->layer[i].thickness;
    depth += to->layer[i].extinction * to->layer[i].thickness;
  }
  for (size_t side = 0; side < SIDES && ok; side++) {
    const bool above = side == 0, alike = above && to->like < of->count;
    const size_t i = alike ? to->like : above ? 0 : of->count - 1;
    const solver_layer *layer = &of->layer[i];
    const solver_phase phase = {.g = layer->g};
    const double arrives = above ? 1 : arriving_beam(&to->ways);
    double far = arrives * solver_far(layer->sigma_s_per_mm * to->unit_mm, &phase,
                                      layer->eta / (above ? 1 : of->eta_below), 1, !above);
    double complex *all_values = values + side * nodes;
    to->wavenumbers[side].isa = isa;
    if (!above && of->sides > 1) {
      double complex *onwards = values + SIDES * nodes;
      const size_t solved = solver_exitance_end(&to->wavenumbers[1], TIERS - 1);
      memset(onwards, 0, nodes * sizeof *onwards);
      pass_onwards(to, of, far, onwards, all_values, stop);
      cut_noise(to, thickness, depth, solved, onwards, all_values);
      far *= to->passes;
    }
    ok = solver_exitance_make(&to->exitance[side], &to->wavenumbers[side], far,
                              solver_peak_at(&phase) * to->layer[i].extinction,
                              alike && i == 0 ? values + SIDES * nodes : all_values, all_values);
  }
  free(values);
  return ok;
}

/* Returns R or T. *size is set to how much of it would be there if nothing cancelled. */
static double value_at(const struct grid *of, size_t side, double r_mm, double *size) {
  const double r = r_mm / of->unit_mm, area = of->unit_mm * of->unit_mm;
  const double value = (side == 0 ? 1 : of->passes) * solver_ways_at(&of->ways, side, r) +
                       solver_exitance_at(&of->exitance[side], &of->wavenumbers[side], r, size);
  *size /= area;
  return value / area;
}

/* ---- solutions ----------------------------------------------------------------------------- */

static const core_fault no_fault = {NULL, NULL, 0};
static const core_fault memory_fault = {CORE_FIELD_MEMORY, "enough for the solution", 0};

/* Least extinction of a layer over the largest one's. The functions of angle do not resolve grazing
 * light in a weaker one that scattering layers enclose: all grids share that error. */
#define WEAKEST 0.02

static bool is_eta(double eta) {
  return eta >= TRANSPORT_ETA_MIN && eta <= TRANSPORT_ETA_MAX;
}

static core_fault check_layer(const solver_layer *layer, size_t i, bool last) {
  const double sigma_t = layer->sigma_a_per_mm + layer->sigma_s_per_mm;
  const bool deep = last && isinf(layer->thickness_mm);
  return !(layer->sigma_a_per_mm >= 0 && isfinite(layer->sigma_a_per_mm))
             ? (core_fault){"sigma_a", "not negative, finite", i}
         : !(layer->sigma_s_per_mm >= 0 && sigma_t > 0 && isfinite(sigma_t))
             ? (core_fault){"sigma_s", "not negative, finite; not 0 where sigma_a is 0", i}
         : !(fabs(layer->g) <= 0.99) ? (core_fault){"g", "-0.99 to 0.99", i}
         : !is_eta(layer->eta)       ? (core_fault){"eta", "0.25 to 4", i}
         : !(layer->thickness_mm > 0 && (deep || isfinite(layer->thickness_mm)))
             ? (core_fault){"thickness", "above 0; infinite for the last layer alone", i}
             : no_fault;
}

core_fault solver_layers_check(const solver_layer *layer, size_t count, double eta_below) {
  if (count < 1 || count > SOLVER_LAYERS_MAX) {
    return (core_fault){"layer_count", "1 to 8", 0};
  }
  for (size_t i = 0; i < count; i++) {
    const core_fault fault = check_layer(&layer[i], i, i + 1 == count);
    if (fault.field != NULL) {
      return fault;
    }
  }
  double most = 0;
  for (size_t i = 0; i < count; i++) {
    most = fmax(most, layer[i].sigma_a_per_mm + layer[i].sigma_s_per_mm);
  }
  for (size_t i = 0; i + 1 < count; i++) {
    if (layer[i].sigma_a_per_mm + layer[i].sigma_s_per_mm < WEAKEST * most) {
      return (core_fault){
          "sigma_s", "sigma_a + sigma_s of a fiftieth of the largest, but in the last layer", i};
    }
  }
  return is_eta(eta_below) ? no_fault : (core_fault){"eta_below", "0.25 to 4", 0};
}

/* The largest error up to so many times as far away or as near is stated (solver_error_near()). */
#define NEIGHBOURS 2.6
#define DECAYS_MOST (SOLVER_DECAYS_MOST * 1.2)

/* Below this many times 1 / K, R and T are made of waves beyond K, which both grids guess. */
#define GUESSED 4.0

/* Without a half space up to so many reduced mean free paths, and under an upper medium of less depth, which guides waves
 * beyond K, the grids' difference oscillates with the radius: so many radii are compared from each
 * stated one to the next. Only of guided waves would a finer grid have less of this. */
#define OSCILLATES 1.0
#define THIN_GUIDES 1.0
enum { SAMPLES = 4 };
#define SAMPLES_RATIO 1.0973 /* SOLVER_ERROR_RATIO^(1/4) */

/* Compares the two grids, and sets the largest relative errors of R and T at radii that a tolerance
 * is for, unless the caller stops. */
static void find_errors(solver_layers *of, double worst[SIDES], const atomic_bool *stop) {
  const struct grid *fine = of->grid[0];
  double margin = of->sides > 1 ? MARGIN_FINITE : MARGIN, weakest = 1, strongest = 0;
  const size_t counted = depth_from(fine, of, 0) < THIN_GUIDES ? SAMPLES : 1;
  for (size_t i = 0; i < of->count; i++) {
    const stack_layer *layer = &fine->layer[i];
    const solver_phase phase = {.g = layer->g};
    margin =
        layer->extinction * layer->thickness < CUT_DEPTH
            ? margin
            : fmax(margin, MARGIN * solver_shared_by_cuts(&phase, layer->medium.moments,
                                                          of->grid[1]->layer[i].medium.moments));
    strongest = fmax(strongest, layer->extinction);
    weakest = layer->extinction * layer->thickness < CUT_DEPTH ? weakest
                                                               : fmin(weakest, layer->extinction);
  }
  of->last = 0;
  for (size_t side = 0; side < of->sides; side++) {
    const exitance_grid *known = &fine->wavenumbers[side];
    const double by = side == 1 && weakest < WEAK * strongest ? WEAK_MARGIN * margin : margin;
    const double guessed = GUESSED / creal(known->point[known->panels]);
    double size, above = 0, seen = 0, r = SOLVER_ERROR_LEAST;
    for (size_t i = 1; i < SOLVER_ERROR_RADII; i++) {
      r *= SOLVER_ERROR_RATIO;
    }
    worst[side] = of->floor[1];
    for (size_t i = SOLVER_ERROR_RADII; i-- > 0 && !solver_stops(stop); r /= SOLVER_ERROR_RATIO) {
      const double r_mm = r * of->radius_mm, units = r_mm / fine->unit_mm;
      const bool near = of->sides > 1 && r < OSCILLATES;
      double error = 0, some = 0, between = r_mm;
      for (size_t j = 0; j < (near ? SAMPLES : counted); j++, between *= SAMPLES_RATIO) {
        const double value = value_at(fine, side, between, &size);
        const double other = value_at(of->grid[1], side, between, &size);
        const double off = solver_error_between(by, value, other);
        error = fmax(error, off);
        some = j < counted ? fmax(some, off) : some;
      }
      if (side == 1 && fine->guess[0] > 0) {
        const double x = fine->guess[0] * units;
        const double missed = fn_log(1 + 1 / (x * x * sqrt(x))) * fn_exp(-fine->guess[1] * units) *
                              fine->guess[2] / (2 * FN_PI);
        const double area = fine->unit_mm * fine->unit_mm;
        error = fmax(error, missed / (area * value_at(fine, side, r_mm, &size)));
      }
      above = fmax(error, units < guessed ? above : 0);
      seen = fmax(some, units < guessed ? seen : 0);
      of->error[side][i] = above;
      const bool decays = units * fine->rate >= DECAYS_MOST;
      of->last = decays || of->last > i ? of->last : i;
      const bool counts =
          r * NEIGHBOURS >= RADIUS_COUNTS && r <= SOLVER_RADIUS_MOST * NEIGHBOURS && !decays;
      worst[side] = counts ? fmax(worst[side], seen) : worst[side];
    }
  }
}

/* Returns a solution without grids; NULL if no memory is left. */
static solver_layers *new_solution(const solver_layer *layer, size_t count, double eta_below) {
  solver_layers *made = calloc(1, sizeof *made);
  if (made != NULL) {
    made->count = count;
    memcpy(made->layer, layer, count * sizeof *layer);
    made->eta_below = eta_below;
    made->sides = isinf(layer[count - 1].thickness_mm) ? 1 : SOLVER_SIDES;
    made->radius_mm = 1 / (layer[0].sigma_a_per_mm + layer[0].sigma_s_per_mm * (1 - layer[0].g));
  }
  return made;
}

/* Adds a finer grid; the one before stays beside it. cost: that of solve_grid(). */
static bool add_grid(solver_layers *to, size_t level, const core_isa *isa, double *cost,
                     const atomic_bool *stop) {
  struct grid *made = calloc(1, sizeof *made);
  if (made == NULL || !solve_grid(made, to, isa, &levels[level], cost, stop)) {
    free(made);
    return false;
  }
  free(to->grid[1]);
  to->grid[1] = to->grid[0];
  to->grid[0] = made;
  to->floor = levels[level].floor;
  return true;
}

/* The largest cost_of() that a grid may have, times the tolerance, but the COARSE ones. */
#define COST_MOST 1e9
enum { COARSE = 2 };

/* Hands a solution over, or frees it where that was not found. */
static core_fault solved_or_fault(solver_layers **solution, solver_layers *made, bool ok,
                                  const atomic_bool *stop) {
  if (!ok) {
    solver_layers_free(made);
    return solver_stops(stop) ? (core_fault){CORE_FIELD_STOPPED, "to be waited for", 0}
                              : memory_fault;
  }
  *solution = made;
  return no_fault;
}

/* Adds grids of the levels from `first` on, while they promise to keep the tolerance and are not too
 * dear. Returns false if memory runs out or the caller stops. */
static bool add_grids(solver_layers *to, size_t first, size_t end, double tolerance,
                      const core_isa *isa, const atomic_bool *stop) {
  double worst[SIDES] = {INFINITY, INFINITY}, before[SIDES];
  bool hopes = true;
  for (size_t level = first; hopes && level < end; level++) {
    double cost = level < COARSE ? (double)INFINITY : COST_MOST / tolerance;
    if (!add_grid(to, level, isa, &cost, stop)) {
      return level >= COARSE && isinf(cost);
    }
    if (level == first) {
      continue;
    }
    memcpy(before, worst, sizeof before);
    find_errors(to, worst, stop);
    if (solver_stops(stop)) {
      return false;
    }
    double most = tolerance;
    for (size_t i = level + 1; i < end; i++) {
      most *= GAIN;
    }
    hopes = false;
    for (size_t side = 0; side < to->sides; side++) {
      hopes |=
          worst[side] < most && solver_goes_on(level + 1, worst[side], before[side], tolerance);
    }
  }
  return true;
}

core_fault solver_layers_solve(solver_layers **solution, const core_isa *isa,
                               const solver_layer *layer, size_t count, double eta_below,
                               double tolerance, const atomic_bool *stop) {
  *solution = NULL;
  const core_fault fault = solver_layers_check(layer, count, eta_below);
  if (fault.field != NULL || !(tolerance >= 0 && tolerance < (double)INFINITY)) {
    return fault.field != NULL ? fault : (core_fault){"tolerance", "not negative, finite", 0};
  }
  solver_layers *made = new_solution(layer, count, eta_below);
  double depth = 0;
  for (size_t i = 0; i < count; i++) {
    depth += (layer[i].sigma_a_per_mm + layer[i].sigma_s_per_mm) * layer[i].thickness_mm;
  }
  const size_t first = tolerance < 3e-3 || depth < THIN_FINE ? COARSE : 0;
  const size_t end = first == 0 || (made != NULL && has_indices(made)) ? GRIDS_MOST : LEVELS;
  bool ok = made != NULL && add_grids(made, first, end, tolerance, isa, stop);
  if (ok && made->grid[1] == NULL) { /* those that are cheap, in place of two that are too dear */
    ok = add_grids(made, 0, COARSE, tolerance, isa, stop);
  }
  return solved_or_fault(solution, made, ok, stop);
}

core_fault solver_layers_solve_level(solver_layers **solution, const core_isa *isa,
                                     const solver_layer *layer, size_t count, double eta_below,
                                     size_t level, const atomic_bool *stop) {
  assert(level < LEVELS);
  *solution = NULL;
  const core_fault fault = solver_layers_check(layer, count, eta_below);
  if (fault.field != NULL) {
    return fault;
  }
  double cost = (double)INFINITY;
  solver_layers *made = new_solution(layer, count, eta_below);
  const bool ok = made != NULL && add_grid(made, level, isa, &cost, stop);
  return solved_or_fault(solution, made, ok, stop);
}

void solver_layers_free(solver_layers *solution) {
  if (solution != NULL) {
    free(solution->grid[0]);
    free(solution->grid[1]);
    free(solution);
  }
}

/* ---- values -------------------------------------------------------------------------------- */

transport_number solver_layers_at(const solver_layers *solution, size_t side, double r_mm) {
  assert(side < SOLVER_SIDES && r_mm >= 0);
  const double r = r_mm / solution->radius_mm;
  if (side >= solution->sides || isinf(r_mm)) {
    return (transport_number){0, 0};
  }
  if (r == 0) {
    return (transport_number){INFINITY, INFINITY};
  }
  double size;
  const double value =
      value_at(solution->grid[0], side, fmin(r, RADIUS_MOST) * solution->radius_mm, &size);
  const double unknown =
      PATH_ERROR * solution->floor[1] * size + DIGITS / (solution->radius_mm * solution->radius_mm);
  if (isnan(value)) {
    return (transport_number){0, (double)INFINITY};
  }
  const double unit = solution->grid[0]->unit_mm / solution->radius_mm;
  const double error = fmax(solver_floor_at(solution->floor, unit, solution->layer[0].eta, r),
                            solver_error_near(solution->error[side], r, solution->last));
  if (value > 0 && r <= RADIUS_MOST && error < 1) {
    return (transport_number){value, error * value + unknown};
  }
  if (r < SOLVER_ERROR_LEAST) {
    return (transport_number){fmax(value, 0), (double)INFINITY};
  }
  /* Without a digit, all that is known is that light falls. */
  const transport_number nearer =
      solver_layers_at(solution, side, fmin(r / NEARER, RADIUS_MOST) * solution->radius_mm);
  return (transport_number){fmax(value, 0), nearer.value + nearer.error + unknown};
}

/* ---- balance ------------------------------------------------------------------------------- */

/* A half space that absorbs less than this part of what it scatters, reflects all light. */
#define ABSORBED_LEAST 1e-14
#define BALANCE_FLOOR 1e-9
#define BALANCE_FLOOR_WHITE 2e-6

/* Sets out[] to the unscattered part of the beam that leaves above and below. */
static void pass_beam(const solver_layers *of, double out[SOLVER_SIDES]) {
  double rho[SOLVER_LAYERS_MAX + 1] = {0}, down[SOLVER_LAYERS_MAX + 1] = {0};
  for (size_t i = of->count; i-- > 0;) {
    const solver_layer *layer = &of->layer[i];
    const double depth = layer->thickness_mm * (layer->sigma_a_per_mm + layer->sigma_s_per_mm);
    const double passed = fn_exp(-depth);
    const double next = i + 1 < of->count ? of->layer[i + 1].eta : of->eta_below;
    const double r0 = solver_beam_reflectance(layer->eta, next);
    const double below = 1 - r0 * rho[i + 1];
    rho[i] = passed == 0 ? 0 : passed * passed * (r0 + (1 - r0) * (1 - r0) * rho[i + 1] / below);
    down[i] = passed * (1 - r0) / below;
  }
  const double r0 = solver_beam_reflectance(of->layer[0].eta, 1);
  double entered = 1 / (1 - r0 * rho[0]);
  out[0] = (1 - r0) * rho[0] * entered;
  for (size_t i = 0; i < of->count; i++) {
    entered *= down[i];
  }
  out[1] = entered;
}

static bool find_balance(const solver_layers *of, const core_isa *isa, size_t degrees,
                         size_t moments, solver_balance *to) {
  struct grid *grid = calloc(1, sizeof *grid);
  stack_exitance at;
  bool ok = grid != NULL;
  if (ok) {
    truncate_layers(grid, of, 0, moments, degrees);
    stack_layer *last = &grid->layer[of->count - 1];
    if (isinf(last->thickness) && last->medium.albedo > 1 - ABSORBED_LEAST) {
      last->medium.albedo = 1 - ABSORBED_LEAST;
      last->kappa = fmax(last->kappa, 1e-7 * last->extinction);
    }
    const expansion_rules rules = {0, degrees, 3};
    stack *expanded = solver_stack_new(isa, &rules, grid->layer, of->count, of->eta_below, NULL);
    ok = expanded != NULL && solver_stack_at(expanded, 0, 0, &at);
    solver_stack_free(expanded);
  }
  for (size_t side = 0; side < SOLVER_SIDES && ok; side++) {
    to->out[side].value = creal(at.all[side] + at.beam[side]) - to->unscattered[side];
  }
  for (size_t i = 0; i < of->count && ok; i++) {
    to->absorbed[i].value = creal(at.net[i][0] - at.net[i][1]);
  }
  free(grid);
  return ok;
}

core_fault solver_layers_balance(const solver_layers *solution, const core_isa *isa,
                                 solver_balance *balance) {
  solver_balance coarse = {0};
  *balance = (solver_balance){0};
  pass_beam(solution, balance->unscattered);
  pass_beam(solution, coarse.unscattered);
  if (!find_balance(solution, isa, 36, 90, balance) ||
      !find_balance(solution, isa, 28, 70, &coarse)) {
    return memory_fault;
  }
  const solver_layer *last = &solution->layer[solution->count - 1];
  const bool white = isinf(last->thickness_mm) && last->sigma_a_per_mm == 0;
  const double least = white ? BALANCE_FLOOR_WHITE : BALANCE_FLOOR;
  for (size_t side = 0; side < SOLVER_SIDES; side++) {
    balance->out[side].error =
        fmax(least, MARGIN * fabs(balance->out[side].value - coarse.out[side].value));
  }
  for (size_t i = 0; i < solution->count; i++) {
    balance->absorbed[i].error =
        fmax(least, MARGIN * fabs(balance->absorbed[i].value - coarse.absorbed[i].value));
  }
  return no_fault;
}
