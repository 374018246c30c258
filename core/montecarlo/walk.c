/* The walk, compiled for each instruction set: one scattering and one flight of every lane.
 *
 * One step treats a whole flight, whatever boundaries it meets, so no lane ever waits for another.
 * A photon that a plane boundary reflects flies on as its mirror image; in a half space it cannot
 * come back to the boundary in the same flight. In a slab all reflections of one flight are at the
 * same angle. So the code draws the number of reflections that the photon survives at once, from
 * the geometric distribution, and unfolds the path into a straight line. In layers a step ends at
 * the first boundary: reflectances differ from one to the next.
 *
 * Each step draws four words from Philox: for deflection, azimuth, path and reflection. The counter
 * is (collisions, photon index, kind of event).
 */
#include "core/montecarlo/walk.h"

#include "core/kernels.h"
#include "core/montecarlo/lane_math.h"

/* The kinds of event, which are the last word of Philox's counter. */
enum { EVENT_SCATTERING = 0, EVENT_LAUNCH = 1 };

struct vector {
  float x;
  float y;
  float z;
};

/* ---- scattering ------------------------------------------------------------------------------ */

/* The deflection by Henyey and Greenstein 1941. With u uniform from (-1, 1), the mean cosine is g
 * if
 *
 *   cos(theta) = [1 + g^2 - ((1 - g^2) / (1 + g u))^2] / (2 g)
 *
 * which cancels for small g and for g near 1. With w = (1 + u) / 2, v = 1 - w, D = 1 - g + 2 g w,
 *
 *   1 - cos = 2 (1 - g)^2 v (1 + g w) / D^2
 *   1 + cos = 2 (1 + g)^2 w (1 - g + g w) / D^2
 *
 * are sums of positive terms for g >= 0. For g < 0 the code uses the mirror image.
 */
struct deflection {
  float cosine;
  float sine;
};

static inline walk_hg hg_of(const walk_medium *m, int32_t layer) {
  return (walk_hg){m->g_sign[layer], m->g_size[layer], m->g_one_minus[layer], m->g_one_plus[layer]};
}

static inline struct deflection deflect(walk_hg by, lane_uniform u) {
  const float inverse = 1.0f / (by.one_minus + 2.0f * by.size * u.w);
  const float near = by.one_minus * inverse;
  const float far = by.one_plus * inverse;
  const float one_minus = 2.0f * near * near * u.v * (1.0f + by.size * u.w);
  const float one_plus = 2.0f * far * far * u.w * (by.one_minus + by.size * u.w);
  return (struct deflection){
      .cosine = by.sign * (0.5f * (one_plus - one_minus)),
      .sine = sqrtf(one_plus * one_minus),
  };
}

/* The deflection in proportion to cos^2: with t = 2 v - 1, the inverse of its distribution is cos =
 * t^(1/3). 1 - cos = (1 - t) / (1 + cos + cos^2), and likewise 1 + cos, keep their digits. `t` is
 * passed as well, so that it keeps its digits near 0. */
static inline struct deflection deflect_by_square(float t, lane_uniform u) {
  const float cosine = lane_cube_root(t);
  const float even = 1.0f + cosine * cosine;
  const float one_minus = 2.0f * u.w / (even + cosine);
  const float one_plus = 2.0f * u.v / (even - cosine);
  return (struct deflection){.cosine = cosine, .sine = sqrtf(one_plus * one_minus)};
}

/* A mixture of two functions: points of the random number below m->share draw from the first one,
 * and the place among these points is the uniform number that it inverts. */
struct drawn {
  lane_mask first;
  uint32_t count; /* number of points of the chosen function */
  uint32_t i;     /* index of the point among these */
  float inverse;  /* 1 / count */
};

static inline struct drawn draw_function(const walk_medium *m, uint32_t bits) {
  const uint32_t point = bits >> 1;
  const lane_mask first = lane_mask_if(point < m->share);
  return (struct drawn){
      .first = first,
      .count = lane_choose(first, m->share, WALK_POINTS - m->share),
      .i = lane_choose(first, point, point - m->share),
      .inverse = lane_select(first, m->share_inverse, m->rest_inverse),
  };
}

static inline struct deflection deflect_two_term(const walk_medium *m, uint32_t bits) {
  const struct drawn drawn = draw_function(m, bits);
  const walk_hg a = hg_of(m, 0), b = m->second;
  const walk_hg by = {
      .sign = lane_select(drawn.first, a.sign, b.sign),
      .size = lane_select(drawn.first, a.size, b.size),
      .one_minus = lane_select(drawn.first, a.one_minus, b.one_minus),
      .one_plus = lane_select(drawn.first, a.one_plus, b.one_plus),
  };
  return deflect(by, lane_uniform_within(drawn.i, drawn.count, drawn.inverse));
}

static inline struct deflection deflect_modified(const walk_medium *m, uint32_t bits) {
  const struct drawn drawn = draw_function(m, bits);
  const lane_uniform u = lane_uniform_within(drawn.i, drawn.count, drawn.inverse);
  const int32_t twice = (int32_t)(2 * drawn.i + 1 - drawn.count);
  const struct deflection one = deflect(hg_of(m, 0), u);
  const struct deflection other = deflect_by_square((float)twice * drawn.inverse, u);
  return (struct deflection){
      .cosine = lane_select(drawn.first, one.cosine, other.cosine),
      .sine = lane_select(drawn.first, one.sine, other.sine),
  };
}

static inline struct vector isotropic(lane_uniform u, lane_direction azimuth) {
  const float sine = 2.0f * sqrtf(u.v * u.w);
  return (struct vector){sine * azimuth.cosine, sine * azimuth.sine, u.w - u.v};
}

/* Returns the direction u turned by the deflection, in the frame of T. Duff et al., "Building an
 * Orthonormal Basis, Revisited", 2017. A step of Newton's method brings its length back to 1, so
 * that rounding does not add up over the walk. */
static inline struct vector turn_direction(struct vector u, struct deflection by,
                                           lane_direction azimuth) {
  const float sign = lane_float((lane_bits(u.z) & UINT32_C(0x80000000)) | lane_bits(1.0f));
  const float a = -1.0f / (sign + u.z);
  const float b = u.x * u.y * a;
  const float p = by.sine * azimuth.cosine;
  const float q = by.sine * azimuth.sine;
  const float x = p * (1.0f + sign * u.x * u.x * a) + q * b + by.cosine * u.x;
  const float y = p * (sign * b) + q * (sign + u.y * u.y * a) + by.cosine * u.y;
  const float z = by.cosine * u.z - (p * sign * u.x + q * u.y);
  const float scale = 1.5f - 0.5f * (x * x + y * y + z * z);
  return (struct vector){x * scale, y * scale, z * scale};
}

/* ---- the boundary ---------------------------------------------------------------------------- */

/* Fresnel's equations for unpolarized light, with the cosines ci inside and ct outside:
 *
 *   F = [((eta ci - ct) / (eta ci + ct))^2 + ((eta ct - ci) / (eta ct + ci))^2] / 2
 */
struct fresnel {
  float s_difference;
  float s_sum;
  float p_difference;
  float p_sum;
  float ct;
  lane_mask total; /* a mask: set for total reflection */
};

static inline walk_boundary boundary_of(const walk_medium *m, int32_t face) {
  return (walk_boundary){m->eta[face], m->by_sine[face], m->cosine_constant[face],
                         m->cosine_factor[face]};
}

static inline struct fresnel fresnel_amplitudes(walk_boundary b, struct vector u) {
  const float sine_squared = u.x * u.x + u.y * u.y;
  const float measured = lane_select(b.by_sine, sine_squared, u.z * u.z);
  const float ct_squared = b.cosine_constant + b.cosine_factor * measured;
  const lane_mask total = lane_mask_if(ct_squared <= 0.0f);
  const float ct = sqrtf(lane_select(total, 0.0f, ct_squared));
  const float ci = fabsf(u.z);
  return (struct fresnel){
      .s_difference = b.eta * ci - ct,
      .s_sum = b.eta * ci + ct,
      .p_difference = b.eta * ct - ci,
      .p_sum = b.eta * ct + ci,
      .ct = ct,
      .total = total,
  };
}

/* Returns the mask of chance < F, computed without a division. */
static inline lane_mask is_reflected(struct fresnel f, float chance) {
  const float s = f.s_difference * f.p_sum;
  const float p = f.p_difference * f.s_sum;
  const float both = f.s_sum * f.p_sum;
  return f.total | lane_mask_if(2.0f * chance * (both * both) < s * s + p * p);
}

/* Returns -ln(F), at most 60, and 0 for total reflection. */
static inline float minus_log_reflectance(struct fresnel f) {
  const float s = f.s_difference / f.s_sum;
  const float p = f.p_difference / f.p_sum;
  const float reflectance = 0.5f * (s * s + p * p);
  const lane_mask visible = lane_mask_if(reflectance > 0x1p-86f);
  const float bounded = lane_select(visible, reflectance, 0x1p-86f);
  const float log = lane_minus_log(1.0f - bounded, bounded);
  return lane_select(f.total, 0.0f, log);
}

/* ---- flights --------------------------------------------------------------------------------- */

/* The end of a flight: the photon's next collision, or the boundary through which it leaves. In
 * layers, the next boundary, too. */
struct landing {
  float z;
  struct vector u;
  float flown; /* length of the flight */
  float way;   /* distance to the boundary by which the photon leaves */
  lane_mask leaves;
  lane_mask collides;
  int32_t layer;
  uint32_t fate; /* enum walk_fate, if the photon leaves */
};

#define REFLECTIONS_MAX 0x1p30f /* larger than the number of reflections in any flight */

static inline struct landing land_in_half_space(const walk_medium *m, float z, struct vector u,
                                                float path, lane_uniform chance) {
  const float below = z + u.z * path;
  const lane_mask crosses = lane_mask_if(below < 0.0f);
  const lane_mask reflected = is_reflected(fresnel_amplitudes(boundary_of(m, 0), u), chance.v);
  const lane_mask leaves = crosses & ~reflected;
  return (struct landing){
      .z = lane_select(leaves, z, fabsf(below)),
      .u = {u.x, u.y, lane_select(crosses, fabsf(u.z), u.z)},
      .flown = lane_select(leaves, 0.0f, path),
      .way = -z / u.z,
      .leaves = leaves,
      .fate = WALK_REFLECTED,
  };
}

/* Returns how many times a photon that meets the boundaries at this angle is reflected before it
 * leaves: n or more times with the probability F^n. */
static inline int32_t reflections(const walk_medium *m, struct vector u, lane_uniform chance) {
  const float log_chance = lane_minus_log(chance.w, chance.v);
  const float log_reflectance = minus_log_reflectance(fresnel_amplitudes(boundary_of(m, 0), u));
  const lane_mask endless = lane_mask_if(log_chance >= REFLECTIONS_MAX * log_reflectance);
  return (int32_t)lane_select(endless, REFLECTIONS_MAX, log_chance / log_reflectance);
}

/* Lands a photon in a slab. The first boundary is `ahead` away, measured along z. The path
 * continues `beyond` that boundary, and meets the boundaries in turn `turns` times more. */
static inline struct landing land_in_slab(const walk_medium *m, float z, struct vector u,
                                          float path, lane_uniform chance) {
  const float thickness = m->thickness[0];
  const float speed = fabsf(u.z);
  const lane_mask up = lane_mask_if(u.z < 0.0f);
  const float ahead = lane_select(up, z, thickness - z);
  const float beyond = speed * path - ahead;
  const lane_mask crosses = lane_mask_if(beyond > 0.0f);
  const float beyond_it = lane_select(crosses, beyond, 0.0f);
  const uint32_t turns = (uint32_t)(int32_t)(beyond_it / thickness);
  const uint32_t survived = (uint32_t)reflections(m, u, chance);
  const lane_mask leaves = crosses & lane_mask_if((int32_t)survived <= (int32_t)turns);

  const lane_mask even_turns = (turns & 1) - 1;
  const lane_mask last_above = up ^ ~even_turns;
  const lane_mask leaves_above = up ^ -(survived & 1);
  const float rest = beyond_it - (float)(int32_t)turns * thickness;
  const float least = lane_select(lane_mask_if(rest > 0.0f), rest, 0.0f);
  const float inside = lane_select(lane_mask_if(least < thickness), least, thickness);
  const float folded = lane_select(last_above, inside, thickness - inside);
  const float landed = lane_select(crosses, folded, z + u.z * path);
  return (struct landing){
      .z = lane_select(leaves, z, landed),
      .u = {u.x, u.y, lane_select(crosses & even_turns, -u.z, u.z)},
      .flown = lane_select(leaves, 0.0f, path),
      .way = (ahead + (float)(int32_t)survived * thickness) / speed,
      .leaves = leaves,
      .fate = lane_choose(leaves_above, WALK_REFLECTED, WALK_TRANSMITTED),
  };
}

static inline struct landing land_in_layers(const walk_medium *m, int32_t layer, float z,
                                            struct vector u, float path, lane_uniform chance) {
  const lane_mask up = lane_mask_if(u.z < 0.0f);
  const float flight = path * m->mfp[layer];
  const float way = lane_select(up, z, m->thickness[layer] - z) / fabsf(u.z);
  const lane_mask meets = lane_mask_if(way <= flight);
  const walk_boundary boundary = boundary_of(m, (int32_t)lane_choose(up, 0, 1) + 2 * layer);
  const struct fresnel fresnel = fresnel_amplitudes(boundary, u);
  const lane_mask passes = meets & ~is_reflected(fresnel, chance.v);
  const lane_mask outermost = lane_mask_if(layer == (int32_t)lane_choose(up, 0, m->last));
  const lane_mask enters = passes & ~outermost;
  const int32_t next = layer + (int32_t)(enters & (up | 1));
  const float turn = lane_select(passes, boundary.eta, 1.0f);
  const float speed = lane_select(passes, fresnel.ct, fabsf(u.z));
  const float head = lane_select(up ^ passes, 0.0f, m->thickness[next]);
  return (struct landing){
      .z = lane_select(meets, head, z + u.z * flight),
      .u = {u.x * turn, u.y * turn, lane_select(up ^ (meets & ~passes), -speed, speed)},
      .flown = lane_select(meets, way, flight),
      .way = 0.0f,
      .leaves = passes & outermost,
      .collides = ~meets,
      .layer = next,
      .fate = lane_choose(up, WALK_REFLECTED, WALK_TRANSMITTED),
  };
}

/* ---- all lanes ------------------------------------------------------------------------------- */

/* Four random words for each lane. A loop of its own fills them in, because its numbers are twice
 * as wide as those of the walk. */
typedef struct random_words {
  uint32_t word[4][WALK_LANES];
} random_words;

static inline void draw_numbers(const walk_medium *m, size_t lanes, const uint32_t *restrict c0,
                                const uint32_t *restrict c1, uint32_t c2, uint32_t c3,
                                random_words *restrict random) {
  const lane_words none = {0}, third = none + c2, fourth = none + c3;
  for (size_t i = 0; i < lanes; i += sizeof none / sizeof *c0) {
    lane_words first,
        second; /* of lanes in the lower halves, and of their neighbours in the upper */
    memcpy(&first, &c0[i], sizeof first);
    memcpy(&second, &c1[i], sizeof second);
    const lane_random lower = lane_philox((lane_random){{first, second, third, fourth}}, m->key);
    const lane_random upper =
        lane_philox((lane_random){{first >> 32, second >> 32, third, fourth}}, m->key);
    for (int k = 0; k < 4; k++) {
      const lane_words both = (lower.word[k] & UINT32_MAX) | upper.word[k] << 32;
      memcpy(&random->word[k][i], &both, sizeof both);
    }
  }
}

/* Returns the new direction after a scattering. phase: walk_phase of the medium, as a constant for
 * the compiler. */
static inline struct vector scatter(const walk_medium *m, int32_t layer, struct vector u,
                                    uint32_t bits, lane_direction azimuth, enum walk_phase phase) {
  if (phase == WALK_ISOTROPIC) {
    return isotropic(lane_uniform_from(bits), azimuth);
  }
  const struct deflection by = phase == WALK_MODIFIED ? deflect_modified(m, bits)
                               : phase == WALK_TWO_TERM
                                   ? deflect_two_term(m, bits)
                                   : deflect(hg_of(m, layer), lane_uniform_from(bits));
  return turn_direction(u, by, azimuth);
}

/* The weight of a photon in layers at the end of a flight. */
static inline void weigh(const walk_medium *m, walk_lanes *restrict w, size_t i,
                         struct landing landing, uint32_t flights, lane_uniform chance) {
  const float albedo = m->albedo[landing.layer];
  const float after = w->weight[i] * lane_select(landing.collides, albedo, 1.0f);
  const float longer = sqrtf((float)(int32_t)flights * m->long_path_inverse);
  const float least = m->roulette_weight * lane_select(lane_mask_if(longer > 1.0f), longer, 1.0f);
  const lane_mask light = landing.collides & lane_mask_if(after < least);
  const lane_mask dies = light & lane_mask_if(chance.v * least >= after);
  w->before[i] = w->weight[i];
  w->after[i] = after;
  w->weight[i] = lane_select(dies, 0.0f, lane_select(light, least, after));
  w->layer[i] = landing.layer;
  w->collided[i] = landing.collides;
  w->fate[i] |= dies & WALK_ENDED;
}

/* What a step knows of each lane before its flight. */
struct departure {
  float cosine[WALK_LANES], sine[WALK_LANES]; /* of the azimuth */
  float path[WALK_LANES];
  float ux[WALK_LANES], uy[WALK_LANES], uz[WALK_LANES]; /* direction after scattering */
};

/* Walks the lanes one step. phase and geometry repeat the medium's fields as constants, so that the
 * compiler makes separate loops for each combination. There are three loops, as processors look ahead
 * too little to overlap lanes in a single one: its chain of dependent operations is too long. */
static inline __attribute__((always_inline)) void
step(const walk_medium *medium, const random_words *restrict random, size_t lanes,
     walk_lanes *restrict w, enum walk_phase phase, enum walk_geometry geometry) {
  const walk_medium m = *medium;
  struct departure d;
  const size_t whole_groups = lanes & ~(size_t)(WALK_GROUP - 1);
  for (size_t i = 0; i < whole_groups; i++) {
    const lane_direction azimuth = lane_azimuth(random->word[1][i]);
    const lane_uniform flight = lane_uniform_from(random->word[2][i]);
    d.cosine[i] = azimuth.cosine;
    d.sine[i] = azimuth.sine;
    d.path[i] = lane_minus_log(flight.v, flight.w);
  }
  for (size_t i = 0; i < whole_groups; i++) {
    const lane_direction azimuth = {d.cosine[i], d.sine[i]};
    const struct vector before = {w->ux[i], w->uy[i], w->uz[i]};
    const int32_t layer = geometry == WALK_LAYERS ? w->layer[i] : 0;
    const lane_mask collided = geometry == WALK_LAYERS ? w->collided[i] : ~UINT32_C(0);
    const struct vector scattered = scatter(&m, layer, before, random->word[0][i], azimuth, phase);
    d.ux[i] = lane_select(collided, scattered.x, before.x);
    d.uy[i] = lane_select(collided, scattered.y, before.y);
    d.uz[i] = lane_select(collided, scattered.z, before.z);
  }
  for (size_t i = 0; i < whole_groups; i++) {
    const lane_uniform chance = lane_uniform_from(random->word[3][i]);
    const int32_t layer = geometry == WALK_LAYERS ? w->layer[i] : 0;
    const struct vector u = {d.ux[i], d.uy[i], d.uz[i]};
    const struct landing landing =
        geometry == WALK_LAYERS ? land_in_layers(&m, layer, w->z[i], u, d.path[i], chance)
        : geometry == WALK_SLAB ? land_in_slab(&m, w->z[i], u, d.path[i], chance)
                                : land_in_half_space(&m, w->z[i], u, d.path[i], chance);
    const uint32_t collisions = w->collisions[i] + (~landing.leaves & 1);
    const lane_mask ended = lane_mask_if(collisions == w->last[i]);
    w->x[i] += u.x * landing.flown;
    w->y[i] += u.y * landing.flown;
    w->z[i] = landing.z;
    w->ux[i] = landing.u.x;
    w->uy[i] = landing.u.y;
    w->uz[i] = landing.u.z;
    w->way[i] = landing.way;
    w->collisions[i] = collisions;
    w->fate[i] = lane_choose(landing.leaves, landing.fate, ended & WALK_ENDED);
    if (geometry == WALK_LAYERS) {
      weigh(&m, w, i, landing, collisions, chance);
    }
  }
}

/* flatten: a call that is not inlined would keep its loop from being vectorized. */
static __attribute__((flatten)) void step_any(const walk_medium *medium, uint32_t high,
                                              size_t lanes, walk_lanes *walk) {
  random_words random;
  const size_t whole_groups = lanes & ~(size_t)(WALK_GROUP - 1);
  draw_numbers(medium, whole_groups, walk->collisions, walk->photon, high, EVENT_SCATTERING,
               &random);
  if (medium->geometry == WALK_LAYERS) {
    step(medium, &random, lanes, walk, WALK_HENYEY_GREENSTEIN, WALK_LAYERS);
    return;
  }
  switch (medium->phase) {
#define STEPS(phase)                                                                               \
  case phase:                                                                                      \
    if (medium->geometry == WALK_SLAB) {                                                           \
      step(medium, &random, lanes, walk, phase, WALK_SLAB);                                        \
    } else {                                                                                       \
      step(medium, &random, lanes, walk, phase, WALK_HALF_SPACE);                                  \
    }                                                                                              \
    break;
    STEPS(WALK_ISOTROPIC)
    STEPS(WALK_HENYEY_GREENSTEIN)
    STEPS(WALK_MODIFIED)
    STEPS(WALK_TWO_TERM)
  }
}

static void launch(const walk_medium *medium, uint64_t first, walk_launch *restrict launched) {
  const walk_medium m = *medium;
  uint32_t photon[WALK_LANES];
  uint32_t collisions[WALK_LANES];
  random_words random;
  for (uint32_t i = 0; i < WALK_LANES; i++) {
    photon[i] = (uint32_t)first + i;
    collisions[i] = 0;
  }
  draw_numbers(&m, WALK_LANES, collisions, photon, (uint32_t)(first >> 32), EVENT_LAUNCH, &random);
  for (size_t i = 0; i < WALK_LANES; i++) {
    const lane_uniform depth = lane_uniform_from(random.word[0][i]);
    const lane_uniform side = lane_uniform_from(random.word[1][i]);
    uint32_t way = 0; /* in the order: up in layer 0, down in layer 0, up in layer 1, ... */
    for (uint32_t j = 0; j <= 2 * m.last; j++) {
      way += lane_mask_if(side.v >= m.first_sum[j]) & 1;
    }
    const int32_t layer = (int32_t)(way / 2);
    const float share = m.first_share[layer];
    const float z =
        m.mfp[layer] * lane_minus_log(depth.v * share, m.first_rest[layer] + depth.w * share);
    const lane_mask down = -(way & 1);
    launched->layer[i] = layer;
    launched->z[i] = lane_select(down, z, m.thickness[layer] - z);
    launched->uz[i] = lane_select(down, 1.0f, -1.0f);
    launched->chance[i] = random.word[2][i] >> 1;
  }
}

/* The only symbol with external linkage. */
extern const walk_functions CORE_PASTE2(walk_functions_, CORE_ISA);
const walk_functions CORE_PASTE2(walk_functions_, CORE_ISA) = {launch, step_any};
