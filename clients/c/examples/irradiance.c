/* An example of a renderer that uses libdipole: computes the light that leaves a translucent plane.
 *
 *   cc -O2 irradiance.c $(pkg-config --cflags --libs dipole) -o irradiance
 *   ./irradiance [ADDRESS] > irradiance.csv
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
 * bits are the same. It writes the numbers as CSV. ADDRESS: see dipole_open(). */
#include <dipole.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define SIDE_MM 20.0
#define IRRADIANCE_W_PER_MM2 1.0
#define TOLERANCE 1e-4

/* pixels and points along a side of the square */
enum { CHANNELS = 3, SIDE_PIXELS = 32, SIDE_POINTS = 24, PIXELS = SIDE_PIXELS * SIDE_PIXELS };

static double point[SIDE_POINTS * SIDE_POINTS][3], pixel[PIXELS][3];
static float power_W[SIDE_POINTS * SIDE_POINTS * CHANNELS];
static double M[PIXELS][CHANNELS], at_home[PIXELS][CHANNELS];

static _Noreturn void fail(const char *what, const dipole_error *error) {
  fprintf(stderr, "irradiance: %s%s%s\n", what, error != NULL ? ": " : "",
          error != NULL ? error->text : "");
  exit(1);
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

/* Does without the daemon, but for the tables. */
static void gather_at_home(dipole_client *client, const dipole_gather_query *query) {
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
                             query->query_count, query->queries_mm, NULL, NULL, at_home[0], NULL,
                             &error)) {
    fail("gather at home", &error);
  }
  for (size_t c = 0; c < CHANNELS; c++) {
    dipole_table_free(tables[c]);
  }
}

int main(int argc, char **argv) {
  const double cell_mm = SIDE_MM / SIDE_POINTS, height_mm = cell_mm / sqrt(acos(-1)) / 2;
  dipole_medium skin[CHANNELS];
  dipole_points *points;
  dipole_client *client;
  dipole_error error;
  const size_t lit = place_cells(SIDE_POINTS, 1, 0, point);
  for (size_t i = 0; i < lit * CHANNELS; i++) {
    power_W[i] = (float)(IRRADIANCE_W_PER_MM2 * cell_mm * cell_mm);
  }
  if (!dipole_open(argc > 1 ? argv[1] : NULL, &client, &error) ||
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
                                     .query_count = place_cells(SIDE_PIXELS, 0, height_mm, pixel),
                                     .tolerance = TOLERANCE};
  if (!dipole_gather(client, &query, NULL, NULL, M[0], NULL, &error)) {
    fail("gather", &error);
  }
  gather_at_home(client, &query);
  if (memcmp(M, at_home, sizeof M) != 0) {
    fail("the bits at home are others", NULL);
  }
  puts("x_mm,y_mm,red_w_per_mm2,green_w_per_mm2,blue_w_per_mm2");
  for (size_t i = 0; i < PIXELS; i++) {
    printf("%.9g,%.9g,%.9g,%.9g,%.9g\n", pixel[i][0], pixel[i][1], M[i][0], M[i][1], M[i][2]);
  }
  dipole_close(client);
  dipole_points_free(points);
  if (fflush(stdout) != 0 || ferror(stdout)) {
    fail("writing standard output", NULL);
  }
  return 0;
}
