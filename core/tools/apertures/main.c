/* apertures FOLDER FILE: solves the media of the table of core/fit/aperture.h and writes it. It keeps
 * what it has solved in FOLDER, so that an interrupted run continues where it stopped.
 *
 * apertures compare FOLDER FILE: compares the table that the program has with media that it was not made
 * from, for a normal tolerance, and writes the relative errors of the share, as core/fit/aperture_errors.def
 * has them. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/fit/aperture.h"
#include "core/solver/solver.h"
#include "core/tools/tools.h"
#include "core/transport/functions.h"

enum {
  PLACES = FIT_APERTURE_PLACES,
  RATIOS = FIT_APERTURE_RATIOS,
  BELOW = FIT_APERTURE_ETAS_BELOW,
  FROM = FIT_APERTURE_ETAS_FROM,
  ETAS = BELOW + FROM,
  GS = FIT_APERTURE_GS,
  CONES = FIT_APERTURE_CONES,
  KEY_BYTES = 256,
  MEDIUM_US = 20000000,
};

/* ---- solving --------------------------------------------------------------------------------- */

/* F of a medium, and the difference of the solver's two grids, which is found for media that the table
 * is compared with. */
struct solved {
  double ratio, g;
  double F[ETAS][CONES][PLACES];
  double error[ETAS][CONES][PLACES];
};

static void solve(struct solved *to, const double etas[ETAS], const double u[CONES],
                  double tolerance) {
  const solver_phase phase = {.g = to->g};
  solver_solution *solution;
  tools_check(solver_solve_cones(&solution, core_isa_select(NULL), to->ratio, &phase, etas, ETAS, u,
                                 CONES, tolerance),
              "the solver");
  for (size_t e = 0; e < ETAS; e++) {
    for (size_t c = 0; c < CONES; c++) {
      for (size_t i = 0; i < PLACES; i++) {
        const transport_number share =
            solver_share_at(solution, e, c, fit_aperture_x(i, to->ratio));
        to->F[e][c][i] = log(share.value / (u[c] * u[c]));
        to->error[e][c][i] = share.error / share.value;
      }
    }
    /* Where nearly all light is absorbed, no light may be found in a narrow cone. */
    for (size_t i = 0; i < PLACES * (CONES - 1); i++) {
      const size_t c = CONES - 2 - i / PLACES, at = i % PLACES;
      to->F[e][c][at] = isfinite(to->F[e][c][at]) ? to->F[e][c][at] : to->F[e][c + 1][at];
    }
  }
  solver_free(solution);
}

/* Media of the table come first, then those that it is compared at, which are spread by the golden
 * ratio and its square, as are their eta and u. */
enum { MADE = RATIOS * GS, COMPARED = 14, MEDIA = MADE + COMPARED };

/* Tolerances of the solver. From both of these on, the quick one leaves errors of a few percent in narrow
 * cones, and the normal one is used. */
#define QUICK 1e-2
#define NORMAL 1e-3
#define NORMAL_FROM_RATIO 3
#define NORMAL_FROM_G 0.6

static double spread(size_t i, double step) {
  const double x = 0.5 + step * (double)i;
  return x - floor(x);
}

/* Returns a number between two nodes of an axis. */
static double between(double (*node)(size_t), size_t count, double place) {
  const double at = place * (double)(count - 1);
  const size_t i = (size_t)at;
  return node(i) + (at - (double)i) * (node(i + 1) - node(i));
}

static void set_medium(size_t i, struct solved *to, double etas[ETAS], double u[CONES]) {
  const size_t k = i < MADE ? 0 : i - MADE;
  to->ratio = i < MADE ? fit_aperture_ratio(i % RATIOS)
                       : between(fit_aperture_ratio, RATIOS, spread(k, 0.6180339887));
  to->g = i < MADE ? fit_aperture_g(i / RATIOS) : FIT_APERTURE_G_MOST * spread(k, 0.7548776662);
  for (size_t e = 0; e < ETAS; e++) {
    const double x = ((double)e + spread(k, 0.3819660113)) / ETAS;
    etas[e] = i < MADE
                  ? fit_aperture_eta(e)
                  : FIT_APERTURE_ETA_LEAST + x * (FIT_APERTURE_ETA_MOST - FIT_APERTURE_ETA_LEAST);
  }
  for (size_t c = 0; c < CONES; c++) {
    const double x = ((double)c + spread(k, 0.5698402910)) / CONES;
    u[c] = i < MADE ? fit_aperture_u(c) : pow(FIT_APERTURE_U_LEAST, 1 - x);
  }
}

struct run {
  const char *folder;
  size_t first; /* index of the first medium to solve */
  struct solved *media;
  tools_progress progress;
};

static void solve_or_read(void *context, size_t item) {
  struct run *run = context;
  struct solved wanted, *to = &run->media[run->first + item];
  double etas[ETAS], u[CONES];
  set_medium(run->first + item, &wanted, etas, u);
  char key[KEY_BYTES];
  const bool dark = wanted.ratio > NORMAL_FROM_RATIO && wanted.g > NORMAL_FROM_G;
  const double tolerance = run->first + item < MADE && !dark ? QUICK : NORMAL;
  snprintf(key, sizeof key, "%g, medium %.9g %.9g, eta from %.9g, u from %.9g", tolerance,
           wanted.ratio, wanted.g, etas[0], u[0]);
  if (!tools_kept(run->folder, key, to, sizeof *to)) {
    to->ratio = wanted.ratio;
    to->g = wanted.g;
    solve(to, etas, u, tolerance);
    tools_keep(run->folder, key, to, sizeof *to);
  }
  tools_progress_add(&run->progress, MEDIUM_US);
}

static void solve_media(struct run *run, size_t first, size_t count) {
  run->first = first;
  tools_make_folder(run->folder);
  tools_progress_start(&run->progress, (double)count * MEDIUM_US);
  tools_each(tools_processors(), count, solve_or_read, run);
  tools_progress_end(&run->progress);
}

/* ---- the table ------------------------------------------------------------------------------- */

/* Replaces `count` values at nodes, `stride` apart, by the terms of their series. */
static void find_terms(double *values, size_t count, size_t stride) {
  double term[PLACES];
  const double last = (double)(count - 1);
  for (size_t j = 0; j < count; j++) {
    term[j] = 0;
    for (size_t i = 0; i < count; i++) {
      const double at = cos(FN_PI * (double)j * ((double)(count - 1 - i)) / last);
      term[j] += (i == 0 || i + 1 == count ? 0.5 : 1) * values[i * stride] * at;
    }
    term[j] *= (j == 0 || j + 1 == count ? 1 : 2) / last;
  }
  for (size_t j = 0; j < count; j++) {
    values[j * stride] = term[j];
  }
}

typedef double terms[ETAS][GS][CONES][RATIOS][PLACES];

/* Makes terms of the values along one index, whose neighbours are `stride` apart. The values are
 * `size`, from `from` on. */
static void transform(double *from, size_t size, size_t count, size_t stride) {
  for (size_t i = 0; i < size; i++) {
    if (i / stride % count == 0) {
      find_terms(from + i, count, stride);
    }
  }
}

static void write_table(const struct solved *media, const char *path) {
  terms *all = tools_allocate(1, sizeof *all);
  for (size_t e = 0; e < ETAS; e++) {
    for (size_t k = 0; k < GS; k++) {
      for (size_t c = 0; c < CONES; c++) {
        for (size_t s = 0; s < RATIOS; s++) {
          memcpy((*all)[e][k][c][s], media[k * RATIOS + s].F[e][c], sizeof(double[PLACES]));
        }
      }
    }
  }
  double *first = &(*all)[0][0][0][0][0];
  const size_t of_eta = (size_t)GS * CONES * RATIOS * PLACES;
  transform(first, ETAS * of_eta, PLACES, 1);
  transform(first, ETAS * of_eta, RATIOS, PLACES);
  transform(first, ETAS * of_eta, CONES, (size_t)RATIOS * PLACES);
  transform(first, ETAS * of_eta, GS, (size_t)CONES * RATIOS * PLACES);
  /* The nodes of eta up to 1 come first. The last of them has eta = 1, where v is 0. */
  for (size_t i = 0; i < of_eta; i++) {
    double below[BELOW];
    for (size_t e = 0; e < BELOW; e++) {
      below[e] = first[(BELOW - 1 - e) * of_eta + i];
    }
    find_terms(below, BELOW, 1);
    for (size_t e = 0; e < BELOW; e++) {
      first[e * of_eta + i] = below[e];
    }
  }
  transform(first + BELOW * of_eta, FROM * of_eta, FROM, of_eta);
  FILE *file = tools_open(path);
  for (size_t row = 0; row < ETAS * of_eta; row += PLACES) {
    long integer[PLACES];
    size_t count = 0;
    for (size_t i = 0; i < PLACES; i++) {
      integer[i] = lround(first[row + i] / FIT_APERTURE_QUANTUM);
      count = integer[i] != 0 ? i + 1 : count;
    }
    fputc((int)count, file);
    for (size_t i = 0; i < count; i++) {
      unsigned long zigzag =
          integer[i] < 0 ? -2UL * (unsigned long)integer[i] - 1 : 2UL * (unsigned long)integer[i];
      for (; zigzag >= 0x80; zigzag >>= 7) {
        fputc((int)((zigzag & 0x7f) | 0x80), file);
      }
      fputc((int)zigzag, file);
    }
  }
  tools_close(file, path);
  free(all);
}

/* ---- comparing ------------------------------------------------------------------------------- */

/* Edges of the ranges of sigma_a / sigma_s', x and u, for each of which the largest error is found. */
static const double ratio_edges[] = {0, 0.1, 1, FIT_APERTURE_RATIO_MOST};
static const double x_edges[] = {FIT_APERTURE_X_LEAST, 0.05, 0.1, 0.2, 0.5, 1, 1e9};
static const double u_edges[] = {FIT_APERTURE_U_LEAST, 0.2, 1};

#define RANGES(edges) (sizeof(edges) / sizeof(edges)[0] - 1)

static bool is_within(const double *edges, double value) {
  return value >= edges[0] && value < edges[1];
}

/* The shares of a region. */
struct region {
  const double *ratio, *x, *u; /* start of each of its ranges; the next edge is the end */
  double most; /* largest relative error, including the difference of the solver's two grids */
};

/* Adds to the region those shares of a medium that are in it. */
static void add_medium(struct region *to, const struct solved *medium, const double etas[ETAS],
                       const double u[CONES]) {
  for (size_t at = 0; at < (size_t)ETAS * CONES; at++) {
    const size_t e = at / CONES, c = at % CONES;
    fit_aperture aperture;
    fit_aperture_row row;
    fit_aperture_prepare(&aperture, medium->g, etas[e], u[c] * fmin(etas[e], 1));
    fit_aperture_medium(&aperture, medium->ratio, &row);
    for (size_t i = 0; i < PLACES && is_within(to->u, u[c]); i++) {
      const double x = fit_aperture_x(i, medium->ratio);
      const double truth = u[c] * u[c] * exp(medium->F[e][c][i]);
      const double off = fabs(fit_aperture_share(&row, log(x)) / truth - 1);
      to->most = is_within(to->x, x) ? fmax(to->most, off + medium->error[e][c][i]) : to->most;
    }
  }
}

/* Media that were not compared may be further off: 1.5 times the largest sum of one half of the media is
 * more than any error of the other half in 35 of the 36 regions. */
#define MARGIN 1.5

static void write_region(FILE *file, struct region *region) {
  if (!(region->most > 0)) {
    tools_fail("no shares from sigma_a / sigma_s' %g, x %g, u %g", region->ratio[0], region->x[0],
               region->u[0]);
  }
  const double most = MARGIN * region->most, unit = pow(10, floor(log10(most)) - 1);
  fprintf(file, "FIT_APERTURE_ERROR(%g, %g, %g, %g, %g, %g, %.1e)\n", region->ratio[0],
          region->ratio[1], region->x[0], region->x[1], region->u[0], region->u[1],
          ceil(most / unit) * unit);
}

static const char head[] =
    "/* Errors of the shares of core/fit/aperture.h, which `make apertures` has found.\n"
    " *\n"
    " * FIT_APERTURE_ERROR(sigma_a / sigma_s' from, to, x from, to, u from, to, error)\n"
    " *   error: %g times the largest relative error of a share at %d media that the table was not "
    "made\n"
    " *   from, with %d eta and %d apertures each, to which is added by how much the solver's own "
    "two\n"
    " *   grids differ there */\n"
    "/* clang-format off */\n";

static void compare(const struct solved *media, const char *path) {
  struct region region;
  FILE *file = tools_open(path);
  fprintf(file, head, MARGIN, COMPARED, ETAS, CONES);
  const size_t xs = RANGES(x_edges), us = RANGES(u_edges);
  for (size_t at = 0; at < RANGES(ratio_edges) * xs * us; at++) {
    region.ratio = &ratio_edges[at / us / xs];
    region.x = &x_edges[at / us % xs];
    region.u = &u_edges[at % us];
    region.most = 0;
    for (size_t m = MADE; m < MEDIA; m++) {
      struct solved copy;
      double etas[ETAS], u[CONES];
      set_medium(m, &copy, etas, u);
      if (is_within(region.ratio, copy.ratio)) {
        add_medium(&region, &media[m], etas, u);
      }
    }
    write_region(file, &region);
  }
  fputs("#undef FIT_APERTURE_ERROR\n", file);
  tools_close(file, path);
}

int main(int count, char **arguments) {
  const bool compares = count == 4 && strcmp(arguments[1], "compare") == 0;
  if (count != (compares ? 4 : 3)) {
    tools_fail("usage: apertures [compare] FOLDER FILE");
  }
  struct run run = {.folder = arguments[count - 2],
                    .media = tools_allocate(MEDIA, sizeof *run.media)};
  solve_media(&run, compares ? MADE : 0, compares ? COMPARED : MADE);
  (compares ? compare : write_table)(run.media, arguments[count - 1]);
  free(run.media);
  return 0;
}
