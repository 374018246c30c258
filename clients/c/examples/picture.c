/* A picture of translucent things: a curved mesh, lit by one lamp with shadow, in measured marble,
 * milk and skin, by three models side by side, and what two of them differ from the third.
 *
 *   make picture
 *
 * The light that enters is sampled at points spread evenly over the mesh; the light that leaves is
 * gathered at each pixel (Jensen and Buhler 2002). The mesh is a rabbit made of ellipsoids that are
 * melted together, with a fine relief. Lengths are in mm. */
#include <math.h>
#include <png.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "clients/c/dipole.h"

enum { SIDE = 224, SHADOW = 1536, CHANNELS = 3, MODELS = 3, MEDIA = 3, COLUMNS = MODELS + 2 };

#define SIZE_MM 26.0    /* of the grid from which the mesh is made */
#define VIEW_MM 23.5    /* the square that a picture shows */
#define CELL_MM 0.2     /* of its cells */
#define POINTS 1e6      /* about how many points are spread over the mesh */
#define SHADOW_BIAS_MM 0.15
#define DIFFERENCE_MOST 0.5 /* relative differences beyond this have the colour of this */
#define PI 3.14159265358979323846

static const char *const media[MEDIA] = {"marble", "wholemilk", "skin1"};
static const char *const models[MODELS] = {"classical", "better", "transport"};

typedef struct vec {
  double x, y, z;
} vec;

static vec add(vec a, double t, vec b) {
  return (vec){a.x + t * b.x, a.y + t * b.y, a.z + t * b.z};
}

static double dot(vec a, vec b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}

static vec cross(vec a, vec b) {
  return (vec){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

static vec unit(vec a) {
  return add((vec){0, 0, 0}, 1 / sqrt(dot(a, a)), a);
}

static void *allocate(size_t count, size_t bytes) {
  void *memory = calloc(count, bytes);
  if (memory == NULL) {
    fputs("picture: out of memory\n", stderr);
    exit(1);
  }
  return memory;
}

/* ---- the mesh ---------------------------------------------------------------------------------- */

/* Ellipsoids: centre, then half axes. */
static const struct {
  vec at, axes;
} parts[] = {
    {{0.5, -4.5, 0}, {6.2, 5.6, 5.4}},     {{-3.6, 2.6, 1.4}, {3.7, 3.4, 3.3}},
    {{-4.6, 7.6, -0.2}, {0.9, 3.9, 1.4}},  {{-1.6, 7.8, -0.6}, {0.9, 3.9, 1.4}},
    {{6.4, -6.0, -1.4}, {1.9, 1.9, 1.9}},  {{-4.2, -8.6, 3.2}, {2.6, 1.5, 1.9}},
    {{2.2, -9.0, 3.8}, {3.0, 1.5, 2.0}},   {{-6.2, 1.8, 3.2}, {1.5, 1.3, 1.5}},
};

/* Returns a function that is negative inside, about the distance near the surface. */
static double field(vec p) {
  const double melt = 1.1;
  double sum = 0;
  for (size_t i = 0; i < sizeof parts / sizeof parts[0]; i++) {
    const vec d = add(p, -1, parts[i].at), a = parts[i].axes;
    const vec s = {d.x / a.x, d.y / a.y, d.z / a.z};
    const vec g = {s.x / a.x, s.y / a.y, s.z / a.z};
    const double k0 = sqrt(dot(s, s)), k1 = sqrt(dot(g, g)) + 1e-9;
    sum += exp(-k0 * (k0 - 1) / k1 / melt * 2);
  }
  const double relief = sin(4.1 * p.x) * cos(3.7 * p.y) + sin(3.9 * p.y) * cos(4.3 * p.z) +
                        sin(4.0 * p.z) * cos(3.8 * p.x);
  return -melt / 2 * log(sum + 1e-300) + 0.07 * relief;
}

static vec normal_at(vec p) {
  const double h = 0.02;
  return unit((vec){field((vec){p.x + h, p.y, p.z}) - field((vec){p.x - h, p.y, p.z}),
                    field((vec){p.x, p.y + h, p.z}) - field((vec){p.x, p.y - h, p.z}),
                    field((vec){p.x, p.y, p.z + h}) - field((vec){p.x, p.y, p.z - h})});
}

typedef struct mesh {
  size_t count, capacity;
  vec (*triangles)[3];
} mesh;

/* Returns where the surface crosses the edge between two corners of the grid. */
static vec crossing(vec a, double fa, vec b, double fb) {
  return add(a, fa / (fa - fb), add(b, -1, a));
}

static void add_triangle(mesh *to, vec a, vec b, vec c) {
  if (to->count == to->capacity) {
    to->capacity = 2 * to->capacity + 4096;
    to->triangles = realloc(to->triangles, to->capacity * sizeof *to->triangles);
    if (to->triangles == NULL) {
      exit(1);
    }
  }
  const vec triangle[3] = {a, b, c};
  memcpy(to->triangles[to->count++], triangle, sizeof triangle);
}

/* Adds the part of the surface in a tetrahedron. */
static void add_tetrahedron(mesh *to, const vec p[4], const double f[4]) {
  unsigned in[4], out[4], ins = 0, outs = 0;
  for (unsigned i = 0; i < 4; i++) {
    if (f[i] < 0) {
      in[ins++] = i;
    } else {
      out[outs++] = i;
    }
  }
  vec cut[4];
  unsigned n = 0;
  for (unsigned i = 0; i < ins; i++) {
    for (unsigned k = 0; k < outs; k++) {
      const unsigned o = ins == 2 && i == 1 ? out[1 - k] : out[k]; /* around the quadrangle */
      cut[n++] = crossing(p[in[i]], f[in[i]], p[o], f[o]);
    }
  }
  if (n >= 3) {
    add_triangle(to, cut[0], cut[1], cut[2]);
  }
  if (n == 4) {
    add_triangle(to, cut[0], cut[2], cut[3]);
  }
}

/* Marches tetrahedra (Doi and Koide 1991), six in each cell of a grid. */
static mesh make_mesh(void) {
  static const unsigned tetrahedra[6][4] = {{0, 1, 3, 7}, {0, 3, 2, 7}, {0, 2, 6, 7},
                                            {0, 6, 4, 7}, {0, 4, 5, 7}, {0, 5, 1, 7}};
  const size_t n = (size_t)(SIZE_MM / CELL_MM) + 1;
  double *values = allocate(n * n * n, sizeof *values);
  mesh made = {0};
  for (size_t i = 0; i < n * n * n; i++) {
    values[i] = field((vec){(double)(i % n) * CELL_MM - SIZE_MM / 2,
                            (double)(i / n % n) * CELL_MM - SIZE_MM / 2,
                            (double)(i / n / n) * CELL_MM - SIZE_MM / 2});
  }
  for (size_t i = 0; i < n * n * n; i++) {
    const size_t x = i % n, y = i / n % n, z = i / n / n;
    if (x + 1 == n || y + 1 == n || z + 1 == n) {
      continue;
    }
    for (size_t t = 0; t < 6; t++) {
      vec p[4];
      double f[4];
      for (size_t k = 0; k < 4; k++) {
        const size_t corner = tetrahedra[t][k];
        const size_t cx = x + (corner & 1), cy = y + (corner >> 1 & 1), cz = z + (corner >> 2);
        p[k] = (vec){(double)cx * CELL_MM - SIZE_MM / 2, (double)cy * CELL_MM - SIZE_MM / 2,
                     (double)cz * CELL_MM - SIZE_MM / 2};
        f[k] = values[(cz * n + cy) * n + cx];
      }
      add_tetrahedron(&made, p, f);
    }
  }
  free(values);
  return made;
}

/* ---- views ------------------------------------------------------------------------------------- */

/* An orthographic view along -w, and the height w of what it sees in each pixel. */
typedef struct view {
  vec u, v, w;
  size_t side;
  double *heights; /* [side][side], -INFINITY where there is nothing */
} view;

static double pixel_mm(const view *of) {
  return VIEW_MM / (double)of->side;
}

static void draw(view *to, const vec triangle[3]) {
  const double mm = pixel_mm(to), half = (double)to->side / 2;
  double x[3], y[3], h[3];
  for (int i = 0; i < 3; i++) {
    x[i] = dot(triangle[i], to->u) / mm + half;
    y[i] = half - dot(triangle[i], to->v) / mm;
    h[i] = dot(triangle[i], to->w);
  }
  const double area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]);
  const long x0 = (long)fmax(0, floor(fmin(x[0], fmin(x[1], x[2]))));
  const long y0 = (long)fmax(0, floor(fmin(y[0], fmin(y[1], y[2]))));
  const long x1 = (long)fmin((double)to->side - 1, ceil(fmax(x[0], fmax(x[1], x[2]))));
  const long y1 = (long)fmin((double)to->side - 1, ceil(fmax(y[0], fmax(y[1], y[2]))));
  for (long j = y0; j <= y1 && area != 0; j++) {
    for (long i = x0; i <= x1; i++) {
      const double px = (double)i + 0.5, py = (double)j + 0.5;
      const double b = ((px - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (py - y[0])) / area;
      const double c = ((x[1] - x[0]) * (py - y[0]) - (px - x[0]) * (y[1] - y[0])) / area;
      double *height = &to->heights[(size_t)j * to->side + (size_t)i];
      if (b >= -1e-9 && c >= -1e-9 && b + c <= 1 + 1e-9) {
        *height = fmax(*height, h[0] + b * (h[1] - h[0]) + c * (h[2] - h[0]));
      }
    }
  }
}

static view look(const mesh *at, vec towards, size_t side) {
  view made = {.w = unit(towards), .side = side};
  made.u = unit(cross((vec){0, 1, 0}, made.w));
  made.v = cross(made.w, made.u);
  made.heights = allocate(side * side, sizeof *made.heights);
  for (size_t i = 0; i < side * side; i++) {
    made.heights[i] = (double)-INFINITY;
  }
  for (size_t i = 0; i < at->count; i++) {
    draw(&made, at->triangles[i]);
  }
  return made;
}

static bool is_lit(const view *lamp, vec p) {
  const double mm = pixel_mm(lamp), half = (double)lamp->side / 2;
  const double x = floor(dot(p, lamp->u) / mm + half), y = floor(half - dot(p, lamp->v) / mm);
  const double most = (double)lamp->side - 1;
  return x < 0 || y < 0 || x > most || y > most ||
         dot(p, lamp->w) >= lamp->heights[(size_t)y * lamp->side + (size_t)x] - SHADOW_BIAS_MM;
}

/* ---- light ------------------------------------------------------------------------------------- */

typedef struct lights {
  uint64_t count;
  double *xyz;
  float *power;
} lights;

/* Spreads points over the mesh, one for each equal piece of its area, at places of a sequence that
 * fills triangles evenly (Roberts 2018), and keeps those that the lamp reaches. Its light has 1
 * W/mm^2 across the beam. */
static lights light(const mesh *at, const view *lamp) {
  double total = 0, passed = 0, next = 0.5;
  double *areas = allocate(at->count, sizeof *areas);
  for (size_t i = 0; i < at->count; i++) {
    const vec *t = at->triangles[i];
    const vec n = cross(add(t[1], -1, t[0]), add(t[2], -1, t[0]));
    areas[i] = sqrt(dot(n, n)) / 2;
    total += areas[i];
  }
  lights made = {0};
  made.xyz = allocate((size_t)POINTS + 2, 3 * sizeof *made.xyz);
  made.power = allocate((size_t)POINTS + 2, CHANNELS * sizeof *made.power);
  double a = 0, b = 0;
  for (size_t i = 0; i < at->count; i++) {
    const vec *t = at->triangles[i];
    for (passed += areas[i] / total * POINTS; next < passed; next += 1) {
      a = fmod(a + 0.7548776662466927, 1);
      b = fmod(b + 0.5698402909980532, 1);
      const bool far = a + b > 1;
      const double s = far ? 1 - a : a, r = far ? 1 - b : b;
      const vec p = add(add(t[0], s, add(t[1], -1, t[0])), r, add(t[2], -1, t[0]));
      const double cosine = dot(normal_at(p), lamp->w);
      if (cosine > 0 && is_lit(lamp, p)) {
        memcpy(made.xyz + 3 * made.count, &p, sizeof p);
        for (int c = 0; c < CHANNELS; c++) {
          made.power[CHANNELS * made.count + (uint64_t)c] = (float)(cosine * total / POINTS);
        }
        made.count++;
      }
    }
  }
  free(areas);
  return made;
}

/* ---- the picture ------------------------------------------------------------------------------- */

typedef struct picture {
  view camera;
  uint64_t count;
  double *queries;  /* [count][3] */
  uint32_t *pixels; /* [count] positions in the view */
  double *M[MODELS];
  uint8_t *rgb; /* [MEDIA * SIDE][COLUMNS * SIDE][3] */
} picture;

static void find_queries(picture *of) {
  const size_t pixels = SIDE * SIDE;
  const double mm = pixel_mm(&of->camera);
  of->queries = allocate(pixels, 3 * sizeof *of->queries);
  of->pixels = allocate(pixels, sizeof *of->pixels);
  for (size_t i = 0; i < pixels; i++) {
    if (of->camera.heights[i] > (double)-INFINITY) {
      const double x = ((double)(i % SIDE) + 0.5 - SIDE / 2.0) * mm;
      const double y = (SIDE / 2.0 - (double)(i / SIDE) - 0.5) * mm;
      const vec p = add(add(add((vec){0, 0, 0}, x, of->camera.u), y, of->camera.v),
                        of->camera.heights[i], of->camera.w);
      memcpy(of->queries + 3 * of->count, &p, sizeof p);
      of->pixels[of->count++] = (uint32_t)i;
    }
  }
}

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
  return of->rgb + 3 * (y * COLUMNS * SIDE + x);
}

/* Colours a row: M of all models with one exposure, then the differences from the last model. */
static void colour_row(picture *of, size_t row) {
  double sum = 0;
  for (uint64_t i = 0; i < of->count * CHANNELS; i++) {
    sum += of->M[MODELS - 1][i];
  }
  const double exposure = 0.32 * (double)(of->count * CHANNELS) / sum;
  for (uint64_t i = 0; i < of->count; i++) {
    const double *best = of->M[MODELS - 1] + i * CHANNELS;
    for (size_t m = 0; m < MODELS; m++) {
      uint8_t *to = cell_pixel(of, row, m, of->pixels[i]);
      double difference = 0;
      for (size_t c = 0; c < CHANNELS; c++) {
        const double M = of->M[m][i * CHANNELS + c];
        to[c] = srgb(exposure * M);
        difference += (M - best[c]) / best[c] / CHANNELS;
      }
      if (m + 1 < MODELS) {
        false_colour(difference, cell_pixel(of, row, MODELS + m, of->pixels[i]));
      }
    }
  }
}

static bool show(void *context, uint64_t answered, uint64_t count) {
  fprintf(stderr, "\r%-30s %3.0f %%", (const char *)context,
          100.0 * (double)answered / (double)count);
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
                                     .queries_mm = of->queries,
                                     .query_count = of->count,
                                     .tolerance = 1e-2};
  snprintf(what, sizeof what, "%s, %s", medium->name, models[model]);
  const bool good = dipole_gather(client, &query, show, what, of->M[model], NULL, &error);
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

static bool write_picture(const picture *of, const char *file) {
  png_image image = {.version = PNG_IMAGE_VERSION,
                     .width = COLUMNS * SIDE,
                     .height = MEDIA * SIDE,
                     .format = PNG_FORMAT_RGB};
  return png_image_write_to_file(&image, file, 0, of->rgb, 0, NULL) != 0;
}

int main(int argc, char **argv) {
  const char *file = argc > 1 ? argv[1] : "picture.png";
  dipole_error error = {.text = "the file cannot be written"};
  dipole_client *client;
  dipole_points *points = NULL;
  picture of = {0};
  const mesh object = make_mesh();
  view lamp = look(&object, (vec){-0.75, 0.55, 0.6}, SHADOW);
  const lights entering = light(&object, &lamp);
  of.camera = look(&object, (vec){-0.35, 0.15, 1}, SIDE);
  find_queries(&of);
  fprintf(stderr, "%zu triangles, %llu points in the light, %llu pixels\n", object.count,
          (unsigned long long)entering.count, (unsigned long long)of.count);
  of.rgb = allocate((size_t)3 * MEDIA * SIDE, COLUMNS * SIDE);
  for (size_t i = 0; i < (size_t)3 * MEDIA * SIDE * COLUMNS * SIDE; i++) {
    of.rgb[i] = 16;
  }
  for (size_t m = 0; m < MODELS; m++) {
    of.M[m] = allocate(of.count, CHANNELS * sizeof *of.M[m]);
  }
  bool good = dipole_open(NULL, &client, &error);
  if (good) {
    good = dipole_points_make(entering.count, CHANNELS, entering.xyz, entering.power, &points,
                              &error) &&
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
  free(of.queries);
  free(of.pixels);
  free(of.camera.heights);
  free(lamp.heights);
  free(entering.xyz);
  free(entering.power);
  free(object.triangles);
  return good ? 0 : 1;
}
