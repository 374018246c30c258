/* A picture of translucent things: a curved body, lit by one lamp with shadow, in measured marble,
 * milk and skin, by three models side by side, and what two of them differ from the third.
 *
 *   make picture
 *
 * Rays of the lamp say where light enters: each brings the same power. The light that leaves is
 * gathered at each pixel (Jensen and Buhler 2002). Transport diverges at r = 0, so the positions
 * where light is gathered lie ABOVE_MM above the body: no single point stands out. The body is a
 * rabbit of ellipsoids that merge, with a fine relief. gnuplot adds the labels. Lengths are in mm. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "clients/c/dipole.h"

enum { SIDE = 224, RAYS = 2000, CHANNELS = 3, MODELS = 3, MEDIA = 3, COLUMNS = MODELS + 2 };
enum { SCALE_HIGH = 12, WIDTH = COLUMNS * SIDE, HEIGHT = MEDIA * SIDE + SCALE_HIGH };

#define VIEW_MM 23.5       /* the square that a view shows */
#define DEPTH_MM 26.0      /* the range of heights in which a ray looks for the body */
#define STEP_LEAST_MM 0.02 /* of a ray */
#define ABOVE_MM 0.02      /* transport lacks its cdf there: 2 % of R in marble, 1 to 6 % in skin */
#define DIFFERENCE_MOST 0.5 /* relative differences beyond this have the colour of this */

static const char *const media[MEDIA] = {"marble", "wholemilk", "skin1"};
static const char *const models[MODELS] = {"classical", "better", "transport"};

typedef struct vec {
  double x, y, z;
} vec;

static vec plus_times(vec a, double t, vec b) {
  return (vec){a.x + t * b.x, a.y + t * b.y, a.z + t * b.z};
}

static double dot(vec a, vec b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}

static vec cross(vec a, vec b) {
  return (vec){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

static vec unit(vec a) {
  return plus_times((vec){0, 0, 0}, 1 / sqrt(dot(a, a)), a);
}

static void *allocate(size_t count, size_t bytes) {
  void *memory = calloc(count, bytes);
  if (memory == NULL) {
    fputs("picture: out of memory\n", stderr);
    exit(1);
  }
  return memory;
}

/* ---- the body ---------------------------------------------------------------------------------- */

/* Ellipsoids: centre, then half axes. */
static const struct {
  vec at, axes;
} parts[] = {
    {{0.5, -4.5, 0}, {6.2, 5.6, 5.4}},    {{-3.6, 2.6, 1.4}, {3.7, 3.4, 3.3}},
    {{-4.6, 7.6, -0.2}, {0.9, 3.9, 1.4}}, {{-1.6, 7.8, -0.6}, {0.9, 3.9, 1.4}},
    {{6.4, -6.0, -1.4}, {1.9, 1.9, 1.9}}, {{-4.2, -8.6, 3.2}, {2.6, 1.5, 1.9}},
    {{2.2, -9.0, 3.8}, {3.0, 1.5, 2.0}},  {{-6.2, 1.8, 3.2}, {1.5, 1.3, 1.5}},
};

/* Returns a function that is negative inside, about the distance near the surface. */
static double field(vec p) {
  const double melt = 1.1;
  double sum = 0;
  for (size_t i = 0; i < sizeof parts / sizeof parts[0]; i++) {
    const vec d = plus_times(p, -1, parts[i].at), a = parts[i].axes;
    const vec s = {d.x / a.x, d.y / a.y, d.z / a.z};
    const vec g = {s.x / a.x, s.y / a.y, s.z / a.z};
    const double k0 = sqrt(dot(s, s)), k1 = sqrt(dot(g, g)) + 1e-9;
    sum += exp(-k0 * (k0 - 1) / k1 / melt * 2);
  }
  const double relief = sin(4.1 * p.x) * cos(3.7 * p.y) + sin(3.9 * p.y) * cos(4.3 * p.z) +
                        sin(4.0 * p.z) * cos(3.8 * p.x);
  return -melt / 2 * log(sum + 1e-300) + 0.07 * relief;
}

/* ---- views ------------------------------------------------------------------------------------- */

/* What the parallel rays of a square meet, which go along -w from the middles of its pixels. */
typedef struct view {
  size_t side;
  uint64_t count;
  double *xyz;      /* [count][3] where rays meet the body, or so far above it */
  uint32_t *pixels; /* [count] positions of these rays in the view */
} view;

/* Moves p along -w to the body (sphere tracing, Hart 1996). Returns whether the ray meets it. */
static bool trace(vec *p, vec w) {
  double gone = 0, step = 0;
  for (double f = field(*p); f > 0; f = field(*p)) {
    step = fmax(f / 3, STEP_LEAST_MM);
    gone += step;
    *p = plus_times(*p, -step, w);
    if (gone > DEPTH_MM) {
      return false;
    }
  }
  for (; step > 1e-6; step /= 2) {
    *p = plus_times(*p, field(*p) > 0 ? -step / 2 : step / 2, w);
  }
  return true;
}

static view look(vec towards, size_t side, double above_mm) {
  const vec w = unit(towards), u = unit(cross((vec){0, 1, 0}, w)), v = cross(w, u);
  const double mm = VIEW_MM / (double)side, half = (double)side / 2;
  view made = {.side = side};
  made.xyz = allocate(side * side, 3 * sizeof *made.xyz);
  made.pixels = allocate(side * side, sizeof *made.pixels);
  for (size_t i = 0; i < side * side; i++) {
    const double x = ((double)(i % side) + 0.5 - half) * mm;
    const double y = (half - (double)(i / side) - 0.5) * mm;
    vec p = plus_times(plus_times(plus_times((vec){0, 0, 0}, x, u), y, v), DEPTH_MM / 2, w);
    if (trace(&p, w)) {
      p = plus_times(p, above_mm, w);
      memcpy(made.xyz + 3 * made.count, &p, sizeof p);
      made.pixels[made.count++] = (uint32_t)i;
    }
  }
  return made;
}

/* ---- the picture ------------------------------------------------------------------------------- */

typedef struct picture {
  view camera;
  double *M[MODELS]; /* [camera.count][CHANNELS] */
  uint8_t *rgb; /* [HEIGHT][WIDTH][3]; the last SCALE_HIGH rows have the scale of differences */
} picture;

static uint8_t srgb(double x) {
  x = fmin(fmax(x, 0), 1);
  return (uint8_t)lrint(255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * pow(x, 1 / 2.4) - 0.055));
}

/* White for 0, red where the model gives more, blue where it gives less. */
static void false_colour(double difference, uint8_t rgb[3]) {
  const double t = fmin(fabs(difference) / DIFFERENCE_MOST, 1);
  const double strong = 1 - 0.15 * t, weak = 1 - t;
  rgb[0] = (uint8_t)lrint(255 * (difference > 0 ? strong : weak));
  rgb[1] = (uint8_t)lrint(255 * weak);
  rgb[2] = (uint8_t)lrint(255 * (difference > 0 ? weak : strong));
}

static uint8_t *cell_pixel(const picture *of, size_t row, size_t column, uint32_t pixel) {
  const size_t y = row * SIDE + pixel / SIDE, x = column * SIDE + pixel % SIDE;
  return of->rgb + 3 * (y * WIDTH + x);
}

/* Colours a row: M of all models with one exposure, then the differences from the last model. */
static void colour_row(picture *of, size_t row) {
  double sum = 0;
  for (uint64_t i = 0; i < of->camera.count * CHANNELS; i++) {
    sum += of->M[MODELS - 1][i];
  }
  const double exposure = 0.32 * (double)(of->camera.count * CHANNELS) / sum;
  for (uint64_t i = 0; i < of->camera.count; i++) {
    const double *best = of->M[MODELS - 1] + i * CHANNELS;
    for (size_t m = 0; m < MODELS; m++) {
      uint8_t *to = cell_pixel(of, row, m, of->camera.pixels[i]);
      double difference = 0;
      for (size_t c = 0; c < CHANNELS; c++) {
        const double M = of->M[m][i * CHANNELS + c];
        to[c] = srgb(exposure * M);
        difference += (M - best[c]) / best[c] / CHANNELS;
      }
      if (m + 1 < MODELS) {
        false_colour(difference, cell_pixel(of, row, MODELS + m, of->camera.pixels[i]));
      }
    }
  }
}

static bool show_progress(void *context, uint64_t done, uint64_t count) {
  fprintf(stderr, "\r%-30s %3.0f %%", (const char *)context, 100.0 * (double)done / (double)count);
  return true;
}

static bool gather(dipole_client *client, const dipole_points *points,
                   const dipole_measured_medium *medium, size_t model, picture *of) {
  char what[64];
  dipole_error error;
  const dipole_gather_query query = {.model = dipole_id(client, DIPOLE_MODEL, models[model]),
                                     .evaluator = DIPOLE_LUT,
                                     .moments = DIPOLE_EXACT,
                                     .points = points,
                                     .media = medium->channel,
                                     .queries_mm = of->camera.xyz,
                                     .query_count = of->camera.count,
                                     .tolerance = 1e-2};
  snprintf(what, sizeof what, "%s, %s", medium->name, models[model]);
  const bool good = dipole_gather(client, &query, show_progress, what, of->M[model], NULL, &error);
  fprintf(stderr, "%s", good ? "\n" : "");
  if (!good) {
    fprintf(stderr, "\npicture: %s\n", error.text);
  }
  return good;
}

static bool paint(dipole_client *client, const dipole_points *points, picture *of) {
  dipole_measured_medium *all;
  dipole_error error;
  size_t count;
  bool good = dipole_media(client, &all, &count, &error);
  for (size_t row = 0; good && row < MEDIA; row++) {
    size_t i = 0;
    while (i < count && strcmp(all[i].name, media[row]) != 0) {
      i++;
    }
    good = i < count;
    for (size_t m = 0; good && m < MODELS; m++) {
      good = gather(client, points, &all[i], m, of);
    }
    if (good) {
      colour_row(of, row);
    }
  }
  free(all);
  return good;
}

/* Draws the colours of the differences from -DIFFERENCE_MOST to DIFFERENCE_MOST below their columns. */
static void draw_scale(picture *of) {
  const size_t begin = MODELS * SIDE, wide = WIDTH - begin;
  for (size_t i = 0; i < wide * SCALE_HIGH; i++) {
    const size_t x = i % wide, y = MEDIA * SIDE + i / wide;
    false_colour(DIFFERENCE_MOST * (2 * (double)x / (double)(wide - 1) - 1),
                 of->rgb + 3 * (y * WIDTH + begin + x));
  }
}

static bool write_picture(const picture *of, const char *file) {
  FILE *gnuplot = popen("gnuplot", "w");
  if (gnuplot == NULL) {
    return false;
  }
  const int top = 24, left = 90, bottom = 24;
  fprintf(gnuplot,
          "set terminal pngcairo size %d,%d font 'sans,11'\nset output '%s'\n"
          "set lmargin at screen %d.0/%d\nset rmargin at screen 1\n"
          "set bmargin at screen %d.0/%d\nset tmargin at screen 1-%d.0/%d\n"
          "unset border\nunset tics\nset xrange [0:%d]\nset yrange [0:%d]\n",
          WIDTH + left, HEIGHT + top + bottom, file, left, WIDTH + left, bottom,
          HEIGHT + top + bottom, top, HEIGHT + top + bottom, WIDTH, HEIGHT);
  for (int m = 0; m < COLUMNS; m++) {
    fprintf(gnuplot, "set label '%s%s' at %d,%d center\n", models[m % MODELS],
            m < MODELS ? "" : " against transport", m * SIDE + SIDE / 2, HEIGHT + 12);
  }
  for (int row = 0; row < MEDIA; row++) {
    fprintf(gnuplot, "set label '%s' at -8,%d right\n", media[row], HEIGHT - row * SIDE - SIDE / 2);
  }
  for (int i = -1; i <= 1; i++) {
    fprintf(gnuplot, "set label '%s%g %%' at %g,-12 %s\n", i > 0 ? "+" : "",
            100 * i * DIFFERENCE_MOST, MODELS * SIDE + (i + 1) * (COLUMNS - MODELS) * SIDE / 2.0,
            i < 0   ? "left"
            : i > 0 ? "right"
                    : "center");
  }
  fprintf(
      gnuplot,
      "plot '-' binary array=(%d,%d) flipy format='%%uchar' using 1:2:3 with rgbimage notitle\n",
      WIDTH, HEIGHT);
  const bool written = fwrite(of->rgb, 3, (size_t)WIDTH * HEIGHT, gnuplot) == WIDTH * HEIGHT;
  return pclose(gnuplot) == 0 && written;
}

int main(int argc, char **argv) {
  const char *file = argc > 1 ? argv[1] : "picture.png";
  dipole_error error = {.text = "gnuplot cannot write the file"};
  dipole_client *client;
  dipole_points *points = NULL;
  picture of = {0};
  const view lamp = look((vec){-0.75, 0.55, 0.6}, RAYS, 0);
  of.camera = look((vec){-0.35, 0.15, 1}, SIDE, ABOVE_MM);
  float *power_W = allocate(lamp.count, CHANNELS * sizeof *power_W);
  for (uint64_t i = 0; i < lamp.count * CHANNELS; i++) { /* 1 W/mm^2 across the beam */
    power_W[i] = (float)(VIEW_MM * VIEW_MM / ((double)RAYS * RAYS));
  }
  fprintf(stderr, "%llu points in the light, %llu pixels\n", (unsigned long long)lamp.count,
          (unsigned long long)of.camera.count);
  of.rgb = allocate((size_t)3 * HEIGHT, WIDTH);
  memset(of.rgb, 16, (size_t)3 * HEIGHT * WIDTH);
  draw_scale(&of);
  for (size_t m = 0; m < MODELS; m++) {
    of.M[m] = allocate(of.camera.count, CHANNELS * sizeof *of.M[m]);
  }
  bool good = dipole_open(NULL, &client, &error);
  if (good) {
    good = dipole_points_make(lamp.count, CHANNELS, lamp.xyz, power_W, &points, &error) &&
           paint(client, points, &of) && write_picture(&of, file);
    dipole_close(client);
  }
  if (!good) {
    fprintf(stderr, "picture: %s: %s\n", file, error.text);
  }
  dipole_points_free(points);
  for (size_t m = 0; m < MODELS; m++) {
    free(of.M[m]);
  }
  free(of.rgb);
  free(of.camera.xyz);
  free(of.camera.pixels);
  free(lamp.xyz);
  free(lamp.pixels);
  free(power_W);
  return good ? 0 : 1;
}
