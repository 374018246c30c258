#include "tests/accuracy/vectors.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#define HEADER "model,moments,sigma_a,sigma_s,g,eta,r,R,albedo,cdf\n"

#define ANISOTROPIC_FILE "tests/accuracy/anisotropic_vectors.csv"
#define ANISOTROPIC_HEADER                                                                         \
  "sigma_a_over_sigma_s_prime,g,eta,r_in_mfp_prime,R_per_square_mfp_prime,relative_error_bound\n"

enum { LINE_BYTES = 1024, ROWS_MAX = 100000, NUMBERS = 8 };

static vector read_row(char *line) {
  char *rest = line;
  const char *model = strsep(&rest, ",");
  const char *moments = rest != NULL ? strsep(&rest, ",") : "";
  const core_choice *model_choice = core_choice_by_name(core_models, model);
  const core_choice *moments_choice = core_choice_by_name(core_moments_list, moments);
  assert_non_null(model_choice);
  assert_non_null(moments_choice);
  double numbers[NUMBERS];
  for (int i = 0; i < NUMBERS; i++) {
    assert_non_null(rest);
    const char *text = strsep(&rest, ",\r\n");
    char *end;
    numbers[i] = strtod(text, &end);
    assert_true(end != text && *end == '\0');
  }
  return (vector){
      .model = model_choice->id,
      .moments = moments_choice->id,
      .medium = {numbers[0], numbers[1], numbers[2], numbers[3]},
      .r_mm = numbers[4],
      .R = numbers[5],
      .albedo = numbers[6],
      .cdf = numbers[7],
  };
}

vector *vectors_read(const char *path, size_t *count) {
  *count = 0;
  FILE *file = fopen(path, "r");
  if (file == NULL) {
    return NULL;
  }
  vector *rows = NULL;
  char line[LINE_BYTES];
  assert_non_null(fgets(line, sizeof line, file));
  assert_string_equal(line, HEADER);
  while (fgets(line, sizeof line, file) != NULL) {
    assert_true(*count < ROWS_MAX);
    vector *larger = realloc(rows, (*count + 1) * sizeof *rows);
    assert_non_null(larger);
    rows = larger;
    rows[(*count)++] = read_row(line);
  }
  fclose(file);
  assert_true(*count > 0);
  return rows;
}

void vectors_read_anisotropic(anisotropic_vector rows[ANISOTROPIC_MEDIA][ANISOTROPIC_RADII]) {
  FILE *file = fopen(ANISOTROPIC_FILE, "r");
  assert_non_null(file);
  char line[LINE_BYTES];
  assert_non_null(fgets(line, sizeof line, file));
  assert_string_equal(line, ANISOTROPIC_HEADER);
  for (size_t i = 0; i < ANISOTROPIC_MEDIA * ANISOTROPIC_RADII; i++) {
    anisotropic_vector *row = &rows[i / ANISOTROPIC_RADII][i % ANISOTROPIC_RADII];
    assert_non_null(fgets(line, sizeof line, file));
    assert_int_equal(sscanf(line, "%lf,%lf,%lf,%lf,%lf,%lf", &row->ratio, &row->g, &row->eta,
                            &row->x, &row->R, &row->error),
                     6);
  }
  assert_null(fgets(line, sizeof line, file));
  fclose(file);
}
