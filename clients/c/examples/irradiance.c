/* An example of a renderer that uses libdipole: computes the light that leaves a translucent plane.
 *
 *   cc -O2 irradiance.c $(pkg-config --cflags --libs dipole) -o irradiance
 *   ./irradiance [ADDRESS [PIXELS [POINTS]]]
 *
 * A square of skin, 20 mm wide, is lit on its left half and in a small disk on its right half. The
 * lit part is covered with sample points i, each of which stands for an area A_i and receives the
 * irradiance E_i, as renderers gather it in a first pass. The power that leaves at x, in W/mm^2, is
 *
 *   M(x) = sum over i of R(|x - x_i|) E_i A_i
 *
 * for each of three channels, by radiative transport. Towards the source, its R grows like 1/r. The
 * mean of 1/r over a disk is its value at half the disk's radius, so no distance counts as less
 * than that for a disk with the area A_i.
 *
 * The program computes M in two ways. First it sends a request for each pixel, with all distances.
 * Many requests are outstanding at the same time, and the library copies their values into the
 * program's own memory. Then the program fetches a table for each channel, with one request, and
 * evaluates the tables itself. The bits are the same.
 *
 * It writes the numbers irradiance.csv to the current folder, and prints the difference of the two
 * results. ADDRESS: see dipole_open(); "" means the default. */
#include <dipole.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define SIDE_MM 20.0f
#define IRRADIANCE_W_PER_MM2 1.0f
#define PI 3.14159265f

enum { CHANNELS = 3, IN_FLIGHT = 32, PIXELS_DEFAULT = 96, POINTS_DEFAULT = 64, MOST = 1024 };

typedef struct scene {
  size_t pixels; /* the picture has pixels x pixels */
  size_t count;  /* the number of lit points */
  float *x, *y;  /* [count], mm */
  float power;   /* E_i A_i, the same for all points, W */
  float least_r; /* mm */
  dipole_medium medium[CHANNELS];
} scene;

static _Noreturn void fail(const char *what, const dipole_error *error) {
  fprintf(stderr, "irradiance: %s%s%s\n", what, error != NULL ? ": " : "",
          error != NULL ? error->text : "");
  exit(1);
}

static void *allocate(size_t count, size_t bytes) {
  void *memory = calloc(count, bytes);
  if (memory == NULL) {
    fail("out of memory", NULL);
  }
  return memory;
}

/* ---- the scene ----------------------------------------------------------------------------- */

static int is_lit(float x, float y) {
  const float dx = x - 0.75f * SIDE_MM, dy = y - 0.5f * SIDE_MM;
  return x < 0.5f * SIDE_MM || dx * dx + dy * dy < 0.01f * SIDE_MM * SIDE_MM;
}

/* Returns the middle of cell i of a side that is divided into `of` cells, mm. */
static float middle(size_t i, size_t of) {
  return ((float)i + 0.5f) * (SIDE_MM / (float)of);
}

/* Divides the square into points x points cells and stores the middles of the lit cells. */
static void place_points(scene *of, size_t points) {
  const float cell_mm = SIDE_MM / (float)points;
  of->x = allocate(points * points, sizeof *of->x);
  of->y = allocate(points * points, sizeof *of->y);
  of->power = IRRADIANCE_W_PER_MM2 * cell_mm * cell_mm;
  of->least_r = cell_mm / sqrtf(PI) / 2;
  for (size_t i = 0; i < points * points; i++) {
    const float x = middle(i % points, points), y = middle(i / points, points);
    if (is_lit(x, y)) {
      of->x[of->count] = x;
      of->y[of->count++] = y;
    }
  }
}

static void find_medium(scene *of, dipole_client *client, const char *name) {
  dipole_measured_medium *media;
  dipole_error error;
  size_t count, i = 0;
  if (!dipole_media(client, &media, &count, &error)) {
    fail("media", &error);
  }
  while (i < count && strcmp(media[i].name, name) != 0) {
    i++;
  }
  if (i == count) {
    fail("the daemon does not know this medium", NULL);
  }
  memcpy(of->medium, media[i].channel, sizeof of->medium);
  free(media);
}

/* Computes the distances of a pixel to all points. r: [count], mm. */
static void distances(const scene *of, size_t pixel, float *r) {
  const float x = middle(pixel % of->pixels, of->pixels);
  const float y = middle(pixel / of->pixels, of->pixels);
  for (size_t i = 0; i < of->count; i++) {
    const float dx = of->x[i] - x, dy = of->y[i] - y;
    r[i] = fmaxf(sqrtf(dx * dx + dy * dy), of->least_r);
  }
}

static double gather(const scene *of, const float *R) {
  double sum = 0;
  for (size_t i = 0; i < of->count; i++) {
    sum += (double)R[i];
  }
  return sum * (double)of->power;
}

/* ---- with the daemon ----------------------------------------------------------------------- */

/* The request for one pixel. */
typedef struct job {
  uint64_t id;
  size_t pixel;
  float *R; /* [CHANNELS][count], the memory for the reply */
} job;

static void submit(const scene *of, dipole_client *client, size_t pixel, float *r, job *to) {
  dipole_error error;
  dipole_query query;
  dipole_query_init(&query); /* transport, by tables; R at listed radii */
  query.media = of->medium, query.medium_count = CHANNELS;
  query.radii = r, query.radius_count = of->count;
  query.into_values = to->R;
  distances(of, pixel, r); /* dipole_submit() copies r, so the next request can reuse it. */
  if (!dipole_submit(client, &query, &to->id, &error)) {
    fail("submit", &error);
  }
  to->pixel = pixel;
}

/* Waits for the next reply and stores the pixel's exitance. Returns the job, which is free now. */
static job *collect(const scene *of, dipole_client *client, job *jobs, double *exitance) {
  dipole_result *result;
  dipole_error error;
  uint64_t id;
  size_t which = 0;
  if (!dipole_collect(client, &id, &result, &error)) {
    fail("collect", &error);
  }
  while (jobs[which].id != id) {
    which++;
  }
  for (size_t c = 0; c < CHANNELS; c++) {
    exitance[jobs[which].pixel * CHANNELS + c] = gather(of, jobs[which].R + c * of->count);
  }
  dipole_result_free(result);
  return &jobs[which];
}

/* Computes all pixels by requests to the daemon. exitance: [pixels * pixels][CHANNELS], W/mm^2. */
static void evaluate_R(const scene *of, dipole_client *client, double *exitance) {
  const size_t all = of->pixels * of->pixels;
  job jobs[IN_FLIGHT] = {0};
  float *r = allocate(of->count, sizeof *r);
  for (size_t i = 0; i < IN_FLIGHT; i++) {
    jobs[i].R = allocate(CHANNELS * of->count, sizeof(float));
  }
  for (size_t pixel = 0; pixel < all; pixel++) {
    job *next = pixel < IN_FLIGHT ? &jobs[pixel] : collect(of, client, jobs, exitance);
    submit(of, client, pixel, r, next);
  }
  while (dipole_outstanding(client) > 0) {
    collect(of, client, jobs, exitance);
  }
  for (size_t i = 0; i < IN_FLIGHT; i++) {
    free(jobs[i].R);
  }
  free(r);
}

/* ---- tables -------------------------------------------------------------------------------- */

static void look_up(const scene *of, dipole_client *client, double *exitance) {
  float *r = allocate(of->count, sizeof *r), *R = allocate(of->count, sizeof *R);
  dipole_table *tables[CHANNELS];
  dipole_error error;
  for (size_t c = 0; c < CHANNELS; c++) {
    const dipole_table_query query = {.model = dipole_id(client, DIPOLE_MODEL, "transport"),
                                      .moments = DIPOLE_EXACT,
                                      .medium = of->medium[c]};
    if (!dipole_table_fetch(client, &query, &tables[c], &error)) {
      fail("table", &error);
    }
  }
  for (size_t pixel = 0; pixel < of->pixels * of->pixels; pixel++) {
    distances(of, pixel, r);
    for (size_t c = 0; c < CHANNELS; c++) {
      if (!dipole_table_values(tables[c], DIPOLE_R, of->count, r, R)) {
        fail("a distance that the table does not cover", NULL);
      }
      exitance[pixel * CHANNELS + c] = gather(of, R);
    }
  }
  for (size_t c = 0; c < CHANNELS; c++) {
    dipole_table_free(tables[c]);
  }
  free(R);
  free(r);
}

/* ---- results ------------------------------------------------------------------------------- */

static void write_numbers(const scene *of, const double *exitance) {
  FILE *file = fopen("irradiance.csv", "w");
  if (file == NULL) {
    fail("irradiance.csv", NULL);
  }
  fputs("x_mm,y_mm,red_w_per_mm2,green_w_per_mm2,blue_w_per_mm2\n", file);
  for (size_t i = 0; i < of->pixels * of->pixels; i++) {
    const double *M = exitance + i * CHANNELS;
    fprintf(file, "%.9g,%.9g,%.9g,%.9g,%.9g\n", (double)middle(i % of->pixels, of->pixels),
            (double)middle(i / of->pixels, of->pixels), M[0], M[1], M[2]);
  }
  if (fclose(file) != 0) {
    fail("writing irradiance.csv", NULL);
  }
}

static void compare(const scene *of, const double *one, const double *other) {
  double most = 0;
  for (size_t i = 0; i < of->pixels * of->pixels * CHANNELS; i++) {
    most = fmax(most, fabs(one[i] / other[i] - 1));
  }
  printf("the largest relative difference is %g\n", most);
}

static size_t size_of(const char *text, size_t usual) {
  char *end;
  const unsigned long size = text != NULL ? strtoul(text, &end, 10) : usual;
  if (size < 1 || size > MOST || (text != NULL && *end != '\0')) {
    fail("PIXELS and POINTS are from 1 to 1024", NULL);
  }
  return size;
}

int main(int argc, char **argv) {
  static void (*const ways[2])(const scene *, dipole_client *, double *) = {evaluate_R, look_up};
  const char *address = argc > 1 && argv[1][0] != '\0' ? argv[1] : NULL;
  scene skin = {.pixels = size_of(argc > 2 ? argv[2] : NULL, PIXELS_DEFAULT)};
  double *exitance[2];
  dipole_client *client;
  dipole_error error;
  if (!dipole_open(address, &client, &error)) {
    fail("open", &error);
  }
  find_medium(&skin, client, "skin1");
  place_points(&skin, size_of(argc > 3 ? argv[3] : NULL, POINTS_DEFAULT));
  const size_t pixels = skin.pixels * skin.pixels;
  printf("%zu pixels, %zu points, %d channels\n", pixels, skin.count, CHANNELS);
  for (size_t i = 0; i < 2; i++) {
    exitance[i] = allocate(pixels * CHANNELS, sizeof *exitance[i]);
    ways[i](&skin, client, exitance[i]);
  }
  compare(&skin, exitance[1], exitance[0]);
  write_numbers(&skin, exitance[0]);
  dipole_close(client);
  free(exitance[0]);
  free(exitance[1]);
  free(skin.x);
  free(skin.y);
  if (fflush(stdout) != 0 || ferror(stdout)) {
    fail("writing standard output", NULL);
  }
  return 0;
}
