/* The kernels that all models share where every value has its own medium (core/varying.h): the
 * statuses of values, and from colours to media. */
#ifdef CORE_ISA

#include "core/cells/find.h"
#include "core/models/lanes.h"

/* The result of checking one value. */
struct checked {
  cells_integer status;
  int ok;
  real albedo; /* sigma_s' / sigma_t' */
  real mfp;    /* the radius in mean free paths */
};

/* most: the largest argument; out_of_range: the status of others; has_reach: whether errors are
 * stated up to some radius only. */
static inline struct checked check_value(const real *shared, real sigma_a, real sigma_s, real in,
                                         real most, cells_integer out_of_range, int has_reach) {
  const struct lane lane = lane_of(shared, sigma_a, sigma_s);
  const real mfp = in * lane.sigma_t;
  const int a = (sigma_a >= 0) & (sigma_a <= shared[LANES_SIGMA_T_MOST]) &
                ((sigma_a > 0) | !(shared[LANES_ABSORBS] > 0));
  const int range = (sigma_s >= 0) & (lane.sigma_t >= shared[LANES_SIGMA_T_LEAST]) &
                    (lane.sigma_t <= shared[LANES_SIGMA_T_MOST]);
  const int ratio = lane_good(shared, sigma_a, sigma_s);
  const int in_range = (in >= 0) & (in <= most);
  int near = 1;
  if (has_reach) {
    const real s = real_sqrt(lane.absorbed);
    const real far = shared[LANES_FAR] + s * (shared[LANES_FAR_S] + s * shared[LANES_FAR_S2]);
    near = !(mfp * far > 1) | !(sigma_s > 0);
  }
  cells_integer status = near ? CORE_VALUE_OK : CORE_VALUE_FAR;
  status = in_range ? status : out_of_range;
  status = ratio ? status : CORE_VALUE_RATIO;
  status = range ? status : CORE_VALUE_SIGMA_S;
  status = a ? status : CORE_VALUE_SIGMA_A;
  /* computed from the conditions: comparing the status would make compilers branch */
  return (struct checked){status, a & range & ratio & in_range & near, lane.scattered, mfp};
}

enum { BLOCK = 64 };

/* Converts statuses to bytes, in a loop of its own so that compilers vectorize both. Returns how
 * many values of the block were computed. */
static inline size_t narrow(size_t n, const cells_integer *restrict wide,
                            uint8_t *restrict status) {
  cells_integer computed = 0;
  for (size_t i = 0; i < n; i++) {
    status[i] = (uint8_t)wide[i];
  }
  for (size_t i = 0; i < BLOCK; i++) {
    computed += wide[i] <= CORE_VALUE_FAR;
  }
  return (size_t)computed;
}

/* Ranges over the values, in BLOCK lanes so that compilers vectorize. */
struct extremes {
  real albedo_least[BLOCK], albedo_most[BLOCK];
  real mfp_least[BLOCK], mfp_most[BLOCK];
  size_t computed;
};

/* Extends each lane's range [least, most] to include x, unless x is NaN. */
static inline void widen(const real *restrict x, real *restrict least, real *restrict most) {
  for (size_t i = 0; i < BLOCK; i++) {
    const real lower = least[i], upper = most[i];
    least[i] = x[i] < lower ? x[i] : lower;
    most[i] = x[i] > upper ? x[i] : upper;
  }
}

__attribute__((always_inline)) static inline void
check_block(const real *restrict shared, const real *restrict sigma_a, const real *restrict sigma_s,
            const real *restrict in, real most, cells_integer out_of_range, int has_reach,
            cells_integer *restrict status, struct extremes *restrict seen) {
  real albedo[BLOCK], mfp[BLOCK];
  for (size_t i = 0; i < BLOCK; i++) {
    const struct checked value =
        check_value(shared, sigma_a[i], sigma_s[i], in[i], most, out_of_range, has_reach);
    status[i] = value.status;
    albedo[i] = value.ok ? value.albedo : (real)NAN;
    mfp[i] = (value.ok & (value.mfp < (real)INFINITY)) ? value.mfp : (real)NAN;
  }
  widen(albedo, seen->albedo_least, seen->albedo_most);
  widen(mfp, seen->mfp_least, seen->mfp_most);
}

/* Combines the lanes to one range. */
static void sum_up(struct extremes *seen, core_varying_range *range) {
  for (size_t half = BLOCK / 2; half > 0; half /= 2) {
    for (size_t i = 0; i < half; i++) {
      seen->albedo_least[i] = real_min(seen->albedo_least[i], seen->albedo_least[i + half]);
      seen->albedo_most[i] = real_max(seen->albedo_most[i], seen->albedo_most[i + half]);
      seen->mfp_least[i] = real_min(seen->mfp_least[i], seen->mfp_least[i + half]);
      seen->mfp_most[i] = real_max(seen->mfp_most[i], seen->mfp_most[i + half]);
    }
  }
  *range = (core_varying_range){seen->computed, (double)seen->albedo_least[0],
                                (double)seen->albedo_most[0], (double)seen->mfp_least[0],
                                (double)seen->mfp_most[0]};
}

/* The last values, padded with NaN to a block: padding is not counted. */
struct last_block {
  real sigma_a[BLOCK], sigma_s[BLOCK], in[BLOCK];
};

static void check(const real *restrict shared, size_t n, const real *restrict sigma_a,
                  const real *restrict sigma_s, const real *restrict in,
                  enum core_varying_argument argument, uint8_t *restrict status,
                  core_varying_range *restrict range) {
  const int numbers = argument == CORE_VARYING_NUMBERS;
  const int has_reach = !numbers && shared[LANES_FAR] > 0;
  const real most = numbers ? 1 : (real)INFINITY;
  const cells_integer out_of_range = numbers ? CORE_VALUE_NUMBER : CORE_VALUE_RADIUS;
  struct last_block last;
  struct extremes seen;
  seen.computed = 0;
  for (size_t i = 0; i < BLOCK; i++) {
    seen.albedo_least[i] = seen.mfp_least[i] = (real)INFINITY;
    seen.albedo_most[i] = seen.mfp_most[i] = 0;
  }
  for (size_t done = 0; done < n; done += BLOCK) {
    const size_t count = n - done < BLOCK ? n - done : BLOCK;
    const real *a = sigma_a + done, *s = sigma_s + done, *x = in + done;
    cells_integer wide[BLOCK];
    if (count < BLOCK) {
      for (size_t i = 0; i < BLOCK; i++) {
        last.sigma_a[i] = i < count ? a[i] : 0;
        last.sigma_s[i] = i < count ? s[i] : 0;
        last.in[i] = i < count ? x[i] : (real)NAN;
      }
      a = last.sigma_a, s = last.sigma_s, x = last.in;
    }
    if (has_reach) {
      check_block(shared, a, s, x, most, out_of_range, 1, wide, &seen);
    } else {
      check_block(shared, a, s, x, most, out_of_range, 0, wide, &seen);
    }
    seen.computed += narrow(count, wide, status + done);
  }
  sum_up(&seen, range);
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
  real free_path, diffuse, classical, extinction;
};

/* scatter: 1 - g of the media */
static inline real free_paths(struct lengths of, real s, real scatter) {
  const real grosjean = s * real_sqrt(3 / (1 + s * s));
  const real classical = s * REAL(1.7320508075688772);
  const real extinction = s * s + (1 - s * s) / scatter;
  return 1 / (of.free_path + of.diffuse * grosjean + of.classical * classical +
              of.extinction * extinction);
}

static void invert(const real *restrict shared, const real *restrict words, const core_colour *what,
                   size_t n, const real *restrict colour, const real *restrict length_mm,
                   real *restrict sigma_a, real *restrict sigma_s, real *restrict albedo,
                   uint8_t *restrict status) {
  const enum core_light light = what->light;
  const struct lengths lengths = {
      what->length == CORE_LENGTH_FREE_PATH, what->length == CORE_LENGTH_DIFFUSE,
      what->length == CORE_LENGTH_CLASSICAL_DIFFUSE, what->length == CORE_LENGTH_EXTINCTION};
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
      const real sigma_t = free_paths(lengths, s, scatter) / length_mm[i];
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
