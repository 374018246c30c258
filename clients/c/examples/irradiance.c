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
 * mean of 1/r over a disk is its value at half the disk's radius, so the pixels stand that high
 * above the plane, for a disk with the area A_i.
 *
 * The daemon computes M, and then the program itself does, with tables that it fetches: the
 * bits are the same. It writes the numbers as CSV. ADDRESS: see dipole_open(); ""
 * means the default. */
#include <dipole.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define SIDE_MM 20.0
#define IRRADIANCE_W_PER_MM2 1.0
#define TOLERANCE 1e-4

enum { CHANNELS = 3, PIXELS_DEFAULT = 96, POINTS_DEFAULT = 64, MOST = 1024 };

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

static size_t size_of(const char *text, size_t usual) {
  char *end;
  const unsigned long size = text != NULL ? strtoul(text, &end, 10) : usual;
  if (size < 1 || size > MOST || (text != NULL && *end != '\0')) {
    fail("PIXELS and POINTS are from 1 to 1024", NULL);
  }
  return size;
}

static int is_lit(double x, double y) {
  const double dx = x - 0.75 * SIDE_MM, dy = y - 0.5 * SIDE_MM;
  return x < 0.5 * SIDE_MM || dx * dx + dy * dy < 0.01 * SIDE_MM * SIDE_MM;
}

/* Stores the middles of side x side cells of the square, at height z_mm, or of those alone that are
 * lit. Returns their number. */
static size_t place_cells(size_t side, int lit_alone, double z_mm, double (*xyz_mm)[3]) {
  size_t count = 0;
  for (size_t i = 0; i < side * side; i++) {
    const double cell_mm = SIDE_MM / (double)side;
    const double x = ((double)(i % side) + 0.5) * cell_mm, y = ((double)(i / side) + 0.5) * cell_mm;
    if (!lit_alone || is_lit(x, y)) {
      memcpy(xyz_mm[count++], (double[3]){x, y, z_mm}, sizeof *xyz_mm);
    }
  }
  return count;
}

static void find_medium(dipole_client *client, const char *name, dipole_medium *channels) {
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
  memcpy(channels, media[i].channel, CHANNELS * sizeof *channels);
  free(media);
}

/* Computes M[query_count][CHANNELS] of a query without the daemon, but for the tables. */
static void gather_at_home(dipole_client *client, const dipole_gather_query *query, double *M) {
  dipole_table *tables[CHANNELS];
  dipole_error error;
  for (size_t c = 0; c < CHANNELS; c++) {
    const dipole_table_query wanted = {
        .model = query->model, .moments = query->moments, .medium = query->media[c]};
    if (!dipole_table_fetch(client, &wanted, &tables[c], &error)) {
      fail("table", &error);
    }
  }
  if (!dipole_gather_at_home((const dipole_table *const *)tables, query->points, query->tolerance,
                             query->query_count, query->queries_mm, NULL, NULL, M, NULL, &error)) {
    fail("gather at home", &error);
  }
  for (size_t c = 0; c < CHANNELS; c++) {
    dipole_table_free(tables[c]);
  }
}

static void write_numbers(size_t count, double (*xyz_mm)[3], const double *M) {
  FILE *file = fopen("irradiance.csv", "w");
  if (file == NULL) {
    fail("irradiance.csv", NULL);
  }
  fputs("x_mm,y_mm,red_w_per_mm2,green_w_per_mm2,blue_w_per_mm2\n", file);
  for (size_t i = 0; i < count; i++, M += CHANNELS) {
    fprintf(file, "%.9g,%.9g,%.9g,%.9g,%.9g\n", xyz_mm[i][0], xyz_mm[i][1], M[0], M[1], M[2]);
  }
  if (fclose(file) != 0) {
    fail("writing irradiance.csv", NULL);
  }
}

int main(int argc, char **argv) {
  const char *address = argc > 1 && argv[1][0] != '\0' ? argv[1] : NULL;
  const size_t side = size_of(argc > 2 ? argv[2] : NULL, PIXELS_DEFAULT), pixels = side * side;
  const size_t cells = size_of(argc > 3 ? argv[3] : NULL, POINTS_DEFAULT);
  const double cell_mm = SIDE_MM / (double)cells, height_mm = cell_mm / sqrt(acos(-1)) / 2;
  double(*point)[3] = allocate(cells * cells, sizeof *point);
  double(*pixel)[3] = allocate(pixels, sizeof *pixel);
  double *M = allocate(pixels * CHANNELS, sizeof *M);
  double *at_home = allocate(pixels * CHANNELS, sizeof *at_home);
  dipole_medium skin[CHANNELS];
  dipole_points *points;
  dipole_client *client;
  dipole_error error;
  const size_t lit = place_cells(cells, 1, 0, point);
  float *power_W = allocate(lit * CHANNELS, sizeof *power_W);
  for (size_t i = 0; i < lit * CHANNELS; i++) {
    power_W[i] = (float)(IRRADIANCE_W_PER_MM2 * cell_mm * cell_mm);
  }
  if (!dipole_open(address, &client, &error) ||
      !dipole_points_make(lit, CHANNELS, point[0], power_W, &points, &error)) {
    fail("open", &error);
  }
  find_medium(client, "skin1", skin);
  const dipole_gather_query query = {.model = dipole_id(client, DIPOLE_MODEL, "transport"),
                                     .evaluator = DIPOLE_LUT,
                                     .moments = DIPOLE_EXACT,
                                     .points = points,
                                     .media = skin,
                                     .queries_mm = pixel[0],
                                     .query_count = place_cells(side, 0, height_mm, pixel),
                                     .tolerance = TOLERANCE};
  printf("%zu pixels, %zu points, %d channels\n", pixels, lit, CHANNELS);
  if (!dipole_gather(client, &query, NULL, NULL, M, NULL, &error)) {
    fail("gather", &error);
  }
  gather_at_home(client, &query, at_home);
  const int same = memcmp(M, at_home, pixels * CHANNELS * sizeof *M) == 0;
  printf("the bits at home are %s\n", same ? "the same" : "others");
  write_numbers(pixels, pixel, M);
  dipole_close(client);
  dipole_points_free(points);
  free(power_W);
  free(at_home);
  free(M);
  free(pixel);
  free(point);
  if (fflush(stdout) != 0 || ferror(stdout)) {
    fail("writing standard output", NULL);
  }
  return 0;
}
