/* The kernels that all models share where every value has a medium of its own (core/varying.h): the
 * statuses of values, and from colours to media. */
#ifdef CORE_ISA

#include "core/models/cells.h"
#include "core/models/lanes.h"

static inline cells_integer status_of(const real *shared, real sigma_a, real sigma_s, real in,
                                      real most, cells_integer out_of_range, real *albedo,
                                      real *mfp) {
  const struct lane lane = lane_of(shared, sigma_a, sigma_s);
  const real s = real_sqrt(lane.absorbed);
  const real far = shared[LANES_FAR] + s * (shared[LANES_FAR_S] + s * shared[LANES_FAR_S2]);
  *albedo = lane.scattered;
  *mfp = in * lane.sigma_t;
  const int a = (sigma_a >= 0) & (sigma_a <= shared[LANES_SIGMA_T_MOST]) &
                ((sigma_a > 0) | !(shared[LANES_ABSORBS] > 0));
  const int range = (sigma_s >= 0) & (lane.sigma_t >= shared[LANES_SIGMA_T_LEAST]) &
                    (lane.sigma_t <= shared[LANES_SIGMA_T_MOST]);
  const int ratio = lane_good(shared, sigma_a, sigma_s);
  const int argument = (in >= 0) & (in <= most);
  const int near = (most <= 1) | !(*mfp * far > 1) | !(sigma_s > 0);
  cells_integer status = near ? CORE_VALUE_OK : CORE_VALUE_FAR;
  status = argument ? status : out_of_range;
  status = ratio ? status : CORE_VALUE_RATIO;
  status = range ? status : CORE_VALUE_SIGMA_S;
  return a ? status : CORE_VALUE_SIGMA_A;
}

/* Statuses are narrowed to bytes in a loop of their own, since compilers vectorize no loop with
 * both. */
enum { BLOCK = 64 };

static void narrow(size_t n, const cells_integer *restrict wide, uint8_t *restrict status) {
  for (size_t i = 0; i < n; i++) {
    status[i] = (uint8_t)wide[i];
  }
}

static void check(const real *restrict shared, size_t n, const real *restrict sigma_a,
                  const real *restrict sigma_s, const real *restrict in,
                  enum core_varying_argument argument, uint8_t *restrict status,
                  real *restrict albedo, real *restrict mfp) {
  const int numbers = argument == CORE_VARYING_NUMBERS;
  const real most = numbers ? 1 : (real)INFINITY;
  const cells_integer out_of_range = numbers ? CORE_VALUE_NUMBER : CORE_VALUE_RADIUS;
  for (size_t done = 0; done < n; done += BLOCK) {
    const size_t end = n - done < BLOCK ? n : done + BLOCK;
    cells_integer wide[BLOCK];
    for (size_t i = done; i < end; i++) {
      real scattered, free_paths;
      const cells_integer found = status_of(shared, sigma_a[i], sigma_s[i], in[i], most,
                                            out_of_range, &scattered, &free_paths);
      const int finite = free_paths < (real)INFINITY;
      wide[i - done] = found;
      albedo[i] = found == CORE_VALUE_OK ? scattered : (real)NAN;
      mfp[i] = (found == CORE_VALUE_OK) & finite ? free_paths : (real)NAN;
    }
    narrow(end - done, wide, status + done);
  }
}

/* Returns s = sqrt(sigma_a / sigma_t') of the medium of a colour, and sets *w to 1 - s. v: the
 * colour over the largest one. */
static inline real invert_colour(const real *words, enum core_light light, real v, real *w) {
  const int near = v <= REAL(0.5);
  const real wanted = near ? v : 1 - v;
  const cells_integer rest = near ? 0 : 1;
  const cells_integer axis = CORE_SURFACE_COLOUR + rest;
  const real kept = cells_kept(words, axis, wanted);
  const struct cells_place place = cells_find(words, axis, kept);
  const cells_integer function = CORE_SURFACE_W_OF_COLOUR + rest * CORE_LIGHTS + light;
  const real value =
      cells_line(words, cells_word(words, CORE_SURFACE_AT + function) + 4 * place.cell, place.t);
  const real found = value * real_min(wanted / kept, 1);
  *w = near ? found : 1 - found;
  return near ? 1 - found : found;
}

/* Returns sigma_t' times the length, for s = sqrt(sigma_a / sigma_t'). The shares are 1 for the
 * kind of length, and else 0. */
struct lengths {
  real free_path, diffuse, classical;
};

static inline real free_paths(struct lengths of, real s) {
  const real grosjean = s * real_sqrt(3 / (1 + s * s));
  const real classical = s * REAL(1.7320508075688772);
  return 1 / (of.free_path + of.diffuse * grosjean + of.classical * classical);
}

static void invert(const real *restrict shared, const real *restrict words, const core_colour *what,
                   size_t n, const real *restrict colour, const real *restrict length_mm,
                   real *restrict sigma_a, real *restrict sigma_s, real *restrict albedo,
                   uint8_t *restrict status) {
  const enum core_light light = what->light;
  const struct lengths lengths = {what->length == CORE_LENGTH_FREE_PATH,
                                  what->length == CORE_LENGTH_DIFFUSE,
                                  what->length == CORE_LENGTH_CLASSICAL_DIFFUSE};
  const real least = shared[LANES_COLOUR_LEAST + light];
  const real most = shared[LANES_COLOUR_MOST + light];
  const real specular = what->specular ? shared[LANES_SPECULAR + light] : 0;
  const real scatter = shared[LANES_SCATTER];
  for (size_t done = 0; done < n; done += BLOCK) {
    const size_t end = n - done < BLOCK ? n : done + BLOCK;
    cells_integer wide[BLOCK];
    for (size_t i = done; i < end; i++) {
      const real entered = (colour[i] - specular) / (1 - specular);
      const int has_medium =
          (entered <= most) & ((entered >= least) | !((entered < 0) | (entered > 0)));
      real w;
      const real s = invert_colour(words, light, real_max(entered, 0) / most, &w);
      const real sigma_t = free_paths(lengths, s) / length_mm[i];
      const real scattered = w * (1 + s) / scatter;
      const real absorbed = s * s;
      const int has_length = (length_mm[i] > 0) & (sigma_t >= shared[LANES_SIGMA_T_LEAST]) &
                             (sigma_t <= shared[LANES_SIGMA_T_MOST]);
      const int good = has_medium & has_length;
      sigma_a[i] = good ? sigma_t * absorbed : (real)NAN;
      sigma_s[i] = good ? sigma_t * scattered : (real)NAN;
      albedo[i] = good ? scattered / (scattered + absorbed) : (real)NAN;
      const cells_integer status_of_length = has_length ? CORE_VALUE_OK : CORE_VALUE_LENGTH;
      wide[i - done] = has_medium ? status_of_length : CORE_VALUE_COLOUR;
    }
    narrow(end - done, wide, status + done);
  }
}

CORE_KERNEL_TABLE(varying, .varying_check = check, .varying_invert = invert);

#endif
