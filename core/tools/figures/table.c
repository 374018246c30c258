#include "core/tools/figures/table.h"
#include "core/tools/tools.h"

#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { LINE_BYTES = 4096 };

void table_put(FILE *file, double number) {
  char text[32] = "";
  for (int digits = 15; digits <= 17 && !isnan(number); digits++) {
    snprintf(text, sizeof text, "%.*g", digits, number);
    if (strtod(text, NULL) == number) {
      break;
    }
  }
  fprintf(file, ",%s", text);
}

/* ---- one panel, to be read again --------------------------------------------------------------
 */

static void header(char *line, size_t bytes, enum panel_source source) {
  size_t length = (size_t)snprintf(line, bytes, "ratio,eta,r");
  for (size_t column = 0; column < COLUMNS; column++) {
    if (panel_column_source(column) == source) {
      length += (size_t)snprintf(line + length, bytes - length, ",%s,albedo_%s",
                                 panel_column_name(column), panel_column_name(column));
    }
  }
  snprintf(line + length, bytes - length, "\n");
}

static void row_start(char *line, size_t bytes, const panel_data *panel, size_t ring) {
  snprintf(line, bytes, "%s,%s,%.17g", panel_ratio_names[panel->ratio], panel_eta_names[panel->eta],
           panel_radius(ring));
}

void table_keep(const char *path, const panel_data *panel, enum panel_source source) {
  char line[LINE_BYTES];
  FILE *file = tools_open(path);
  header(line, sizeof line, source);
  fputs(line, file);
  for (size_t ring = 0; ring < PANEL_RINGS; ring++) {
    row_start(line, sizeof line, panel, ring);
    fputs(line, file);
    for (size_t column = 0; column < COLUMNS; column++) {
      if (panel_column_source(column) == source) {
        table_put(file, panel->value[column][ring]);
        table_put(file, panel->albedo[column]);
      }
    }
    fputc('\n', file);
  }
  tools_close(file, path);
}

/* Reads a comma and a number, which is NaN if nothing follows the comma. */
static bool take(const char **text, double *number) {
  char *end;
  if (**text != ',') {
    return false;
  }
  ++*text;
  *number = (double)NAN;
  if (**text == ',' || **text == '\n') {
    return true;
  }
  *number = strtod(*text, &end);
  const bool good = end != *text && !isnan(*number);
  *text = end;
  return good;
}

static bool recall_row(const char *line, panel_data *panel, size_t ring, enum panel_source source) {
  char start[LINE_BYTES];
  row_start(start, sizeof start, panel, ring);
  if (strncmp(line, start, strlen(start)) != 0) {
    return false;
  }
  line += strlen(start);
  for (size_t column = 0; column < COLUMNS; column++) {
    if (panel_column_source(column) == source &&
        (!take(&line, &panel->value[column][ring]) || !take(&line, &panel->albedo[column]))) {
      return false;
    }
  }
  return strcmp(line, "\n") == 0;
}

bool table_recall(const char *path, panel_data *target, enum panel_source source) {
  char line[LINE_BYTES], expected[LINE_BYTES];
  FILE *file = fopen(path, "re");
  if (file == NULL) {
    return false;
  }
  panel_data read = *target;
  header(expected, sizeof expected, source);
  bool good = fgets(line, sizeof line, file) != NULL && strcmp(line, expected) == 0;
  for (size_t ring = 0; good && ring < PANEL_RINGS; ring++) {
    good = fgets(line, sizeof line, file) != NULL && recall_row(line, &read, ring, source);
  }
  good = good && fgetc(file) == EOF && feof(file);
  fclose(file);
  if (good) {
    *target = read;
    target->known[source] = true;
  }
  return good;
}

/* ---- what is beside a figure ------------------------------------------------------------------
 */

static void put_panel(FILE *file, size_t figure, const panel_data *panel) {
  for (size_t ring = 0; ring < PANEL_RINGS; ring++) {
    char line[LINE_BYTES];
    row_start(line, sizeof line, panel, ring);
    fprintf(file, "%zu,%s", figure, line);
    table_put(file, panel_edge(ring));
    table_put(file, panel_edge(ring + 1));
    for (size_t column = 0; column < COLUMNS; column++) {
      table_put(file, panel->value[column][ring]);
    }
    fputc('\n', file);
  }
}

void table_write_figure(const char *path, size_t figure, const panel_data *const *panels,
                        size_t count) {
  FILE *file = tools_open(path);
  fputs("figure,ratio,eta,r,ring_from,ring_to", file);
  for (size_t column = 0; column < COLUMNS; column++) {
    fprintf(file, ",%s", panel_column_name(column));
  }
  fputc('\n', file);
  for (size_t i = 0; i < count; i++) {
    put_panel(file, figure, panels[i]);
  }
  tools_close(file, path);
}

/* Returns the error of a column's albedo, or NaN if the column has none. */
static double error_of(const panel_data *panel, size_t column) {
  return column == COLUMN_MONTE_CARLO ? panel->albedo[COLUMN_MONTE_CARLO_ERROR]
         : column == COLUMN_TRANSPORT ? panel->albedo[COLUMN_TRANSPORT_ERROR]
                                      : (double)NAN;
}

void table_write_albedos(const char *path, size_t figure, const panel_data *const *panels,
                         size_t count) {
  FILE *file = tools_open(path);
  fputs("figure,ratio,eta,curve,albedo,error,relative_to_transport\n", file);
  for (size_t i = 0; i < count; i++) {
    for (size_t column = 0; column < COLUMNS; column++) {
      if (panel_column_is_curve(column)) {
        fprintf(file, "%zu,%s,%s,%s", figure, panel_ratio_names[panels[i]->ratio],
                panel_eta_names[panels[i]->eta], panel_column_name(column));
        table_put(file, panels[i]->albedo[column]);
        table_put(file, error_of(panels[i], column));
        table_put(file, panels[i]->albedo[column] / panels[i]->albedo[COLUMN_TRANSPORT]);
        fputc('\n', file);
      }
    }
  }
  tools_close(file, path);
}
