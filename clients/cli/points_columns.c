/* The columns of `dipole points`: which there are, where they stand, and rows written by them. */
#include <stdlib.h>
#include <string.h>

#include "clients/cli/number.h"
#include "clients/cli/points.h"

static const struct {
  const char *name;
  bool required;
} inputs[CLI_POINTS_INPUTS] = {
    [CLI_POINTS_MODEL] = {"model", false},
    [CLI_POINTS_MOMENTS] = {"moments", false},
    [CLI_POINTS_SIGMA_A] = {"sigma_a", true},
    [CLI_POINTS_SIGMA_S] = {"sigma_s", true},
    [CLI_POINTS_G] = {"g", true},
    [CLI_POINTS_ETA] = {"eta", true},
    [CLI_POINTS_RADIUS] = {"r", true},
};

static const char *const outputs[CLI_POINTS_OUTPUTS] = {
    [CLI_POINTS_R] = "R",
    [CLI_POINTS_ALBEDO] = "albedo",
    [CLI_POINTS_CDF] = "cdf",
    [CLI_POINTS_STATUS] = "status",
};

const char *cli_points_input_name(enum cli_points_input input) {
  return inputs[input].name;
}

/* ---- the header ---------------------------------------------------------------------------- */

/* The place for the position of a parameter's column, which is added when there is none. */
static size_t *parameter_place(cli_points_columns *columns, const dipole_choice *parameter) {
  size_t i = 0;
  while (i < columns->parameter_count && columns->parameters[i] != parameter) {
    i++;
  }
  if (i == CLI_PARAMETERS_MAX) {
    return NULL;
  }
  if (i == columns->parameter_count) {
    columns->parameters[i] = parameter;
    columns->parameter_at[i] = CLI_POINTS_ABSENT;
    columns->parameter_count++;
  }
  return &columns->parameter_at[i];
}

/* The place for the position of a column of this name; NULL: the column is not one of ours. */
static size_t *place_of(cli_points_columns *columns, const dipole_info *info, const char *name) {
  for (size_t i = 0; i < CLI_POINTS_INPUTS; i++) {
    if (strcmp(inputs[i].name, name) == 0) {
      return &columns->input_at[i];
    }
  }
  for (size_t i = 0; i < CLI_POINTS_OUTPUTS; i++) {
    if (strcmp(outputs[i], name) == 0) {
      return &columns->output_at[i];
    }
  }
  const dipole_choice *parameter = cli_choice(info, DIPOLE_PARAMETER, name);
  return parameter != NULL ? parameter_place(columns, parameter) : NULL;
}

static void fail_missing(const cli_command *command, const char *source, const char *missing,
                         const cli_csv_record *header) {
  char *text = NULL;
  size_t bytes = 0, length;
  FILE *found = open_memstream(&text, &bytes);
  for (size_t i = 0; found != NULL && i < header->cell_count; i++) {
    char *name = cli_csv_cell_text(header, i, &length);
    fprintf(found, "%s%s", i > 0 ? ", " : "", name);
    free(name);
  }
  if (found != NULL) {
    fclose(found);
  }
  cli_fail(command,
           "%s: the column %s is missing; the header has %s; it needs sigma_a, sigma_s, g, eta "
           "and r, and may have model, moments and parameters",
           source, missing, text != NULL ? text : "others");
  free(text);
}

bool cli_points_find_columns(const cli_command *command, const char *source,
                             const dipole_info *info, const cli_csv_record *header,
                             cli_points_columns *columns) {
  size_t length;
  memset(columns, 0xff, sizeof *columns); /* CLI_POINTS_ABSENT everywhere */
  columns->count = header->cell_count;
  columns->parameter_count = 0;
  for (size_t i = 0; i < header->cell_count; i++) {
    char *name = cli_csv_cell_text(header, i, &length);
    size_t *place = place_of(columns, info, name);
    const bool twice = place != NULL && *place != CLI_POINTS_ABSENT;
    if (twice) {
      cli_fail(command, "%s: the header has the column %s twice", source, name);
    } else if (place != NULL) {
      *place = i;
    }
    free(name);
    if (twice) {
      return false;
    }
  }
  for (size_t i = 0; i < CLI_POINTS_INPUTS; i++) {
    if (inputs[i].required && columns->input_at[i] == CLI_POINTS_ABSENT) {
      fail_missing(command, source, inputs[i].name, header);
      return false;
    }
  }
  return true;
}

/* ---- writing ------------------------------------------------------------------------------- */

/* The line's end as it was read; the last line of a file may lack one. */
static void write_ending(const cli_csv_record *record, FILE *file) {
  if (record->ending_bytes == 0) {
    fputc('\n', file);
  } else {
    fwrite(record->bytes + record->length - record->ending_bytes, 1, record->ending_bytes, file);
  }
}

void cli_points_write_header(const cli_points_columns *columns, const cli_csv_record *header,
                             FILE *file) {
  fwrite(header->bytes, 1, header->length - header->ending_bytes, file);
  for (size_t i = 0; i < CLI_POINTS_OUTPUTS; i++) {
    if (columns->output_at[i] == CLI_POINTS_ABSENT) {
      fprintf(file, ",%s", outputs[i]);
    }
  }
  write_ending(header, file);
}

static void write_output(const cli_points_row *row, enum cli_points_output output, FILE *file) {
  char text[CLI_NUMBER_BYTES];
  const bool good = row->state == CLI_POINTS_GOOD;
  switch (output) {
  case CLI_POINTS_STATUS:
    cli_csv_write_cell(good ? "ok" : row->status, file);
    return;
  case CLI_POINTS_R:
    fputs(good ? cli_number_format(row->R, text) : "", file);
    return;
  case CLI_POINTS_ALBEDO:
    fputs(good ? cli_number_format(row->albedo, text) : "", file);
    return;
  case CLI_POINTS_CDF:
    fputs(good ? cli_number_format(row->cdf, text) : "", file);
    return;
  case CLI_POINTS_OUTPUTS:
    return;
  }
}

/* The output that stands in a column; CLI_POINTS_OUTPUTS: none. */
static enum cli_points_output output_in(const cli_points_columns *columns, size_t column) {
  enum cli_points_output output = 0;
  while (output < CLI_POINTS_OUTPUTS && columns->output_at[output] != column) {
    output++;
  }
  return output;
}

void cli_points_write_row(const cli_points_columns *columns, const cli_points_row *row,
                          FILE *file) {
  const cli_csv_record *record = &row->record;
  for (size_t i = 0; i < columns->count; i++) {
    const enum cli_points_output output = output_in(columns, i);
    fputs(i > 0 ? "," : "", file);
    if (output != CLI_POINTS_OUTPUTS) {
      write_output(row, output, file);
    } else if (i < record->cell_count) {
      cli_csv_copy_cell(record, i, file);
    }
  }
  for (enum cli_points_output output = 0; output < CLI_POINTS_OUTPUTS; output++) {
    if (columns->output_at[output] == CLI_POINTS_ABSENT) {
      fputc(',', file);
      write_output(row, output, file);
    }
  }
  for (size_t i = columns->count; i < record->cell_count; i++) { /* more than the header has */
    fputc(',', file);
    cli_csv_copy_cell(record, i, file);
  }
  write_ending(record, file);
}
