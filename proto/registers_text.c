/* The tables of REGISTERS.md. */
#include <stdio.h>

#include "proto/registers.h"

struct description {
  void (*print)(void *context, const char *text);
  void *context;
};

enum { ROW_BYTES = 512, CELL_BYTES = 80 };

static void title(const struct description *to, const char *name, const char *columns) {
  char text[ROW_BYTES];
  snprintf(text, sizeof text, "### %s\n| %s |\n|", name, columns);
  to->print(to->context, text);
  to->print(to->context, "---|");
  for (const char *c = columns; *c != '\0'; c++) {
    if (*c == '|') {
      to->print(to->context, "---|");
    }
  }
  to->print(to->context, "\n");
}

static bool is_mirror(const registers_block *block) {
  return block->first / REGISTERS_MIRROR % 2 == 1;
}

/* Returns the mirror of a block, or NULL if it has none. */
static const registers_block *mirror_of(const registers_block *block) {
  for (unsigned i = 0; i < REGISTERS_BLOCKS; i++) {
    if (registers_blocks[i].first == block->first + REGISTERS_MIRROR) {
      return &registers_blocks[i];
    }
  }
  return NULL;
}

static void describe_blocks(const struct description *to) {
  title(to, "Blocks", "id | PDU | CDAB: id, PDU | name | what it is");
  for (const registers_block *block = registers_blocks; block < registers_blocks + REGISTERS_BLOCKS;
       block++) {
    if (is_mirror(block)) {
      continue;
    }
    char row[ROW_BYTES], mirrored[CELL_BYTES] = "";
    const registers_block *mirror = mirror_of(block);
    if (mirror != NULL) {
      snprintf(mirrored, sizeof mirrored, "%u, %u", mirror->id, mirror->first);
    }
    snprintf(row, sizeof row, "| %u | %u to %u | %s | %s | %s |\n", block->id, block->first,
             block->first + block->length - 1, mirrored, block->name, block->about);
    to->print(to->context, row);
  }
  to->print(to->context, "\n");
}

/* ---- registers of jobs ----------------------------------------------------------------------- */

/* The registers that the kinds of jobs have in common, by their place in registers_job. */
enum { JOB_REGISTERS = 12 };

/* Sets at[] to the addresses of a job's registers; 0: it has none of this kind. */
static void list_job(const registers_job *job, unsigned at[JOB_REGISTERS]) {
  const unsigned all[JOB_REGISTERS] = {
      job->commit,
      job->cancel,
      job->deadline,
      job->status,
      job->status + REGISTERS_BEHIND_DONE,
      job->status + REGISTERS_BEHIND_ERROR,
      job->status + REGISTERS_BEHIND_ERROR_ADDRESS,
      job->status + REGISTERS_BEHIND_SEQUENCE,
      job->status + REGISTERS_BEHIND_COUNT,
      job->place,
      job->progress,
      job->error_text,
  };
  memcpy(at, all, sizeof all);
}

static bool is_of_jobs(const registers_field *field) {
  for (unsigned i = 0; i < REGISTERS_JOBS; i++) {
    unsigned at[JOB_REGISTERS];
    list_job(&registers_jobs[i], at);
    for (unsigned k = 0; k < JOB_REGISTERS; k++) {
      if (at[k] == field->address && at[k] > 0) {
        return true;
      }
    }
  }
  return false;
}

/* Returns the field that starts at an address. */
static const registers_field *field_starting_at(unsigned address) {
  const registers_field *field = registers_fields;
  while (field->name != NULL && field->address != address) {
    field++;
  }
  return field;
}

static void describe_jobs(const struct description *to) {
  title(to, "Registers of jobs", "name | eval | sample | invert | mc | fit | meaning");
  for (unsigned k = 0; k < JOB_REGISTERS; k++) {
    char cell[ROW_BYTES];
    const registers_field *field = NULL;
    unsigned at[REGISTERS_JOBS][JOB_REGISTERS];
    for (unsigned i = 0; i < REGISTERS_JOBS; i++) {
      list_job(&registers_jobs[i], at[i]);
      field = field == NULL && at[i][k] > 0 ? field_starting_at(at[i][k]) : field;
    }
    snprintf(cell, sizeof cell, "| %s |", field->name);
    to->print(to->context, cell);
    for (unsigned i = 0; i < REGISTERS_JOBS; i++) {
      snprintf(cell, sizeof cell, at[i][k] > 0 ? " %u |" : " |", at[i][k]);
      to->print(to->context, cell);
    }
    snprintf(cell, sizeof cell, " %s |\n", field->about);
    to->print(to->context, cell);
  }
  to->print(to->context, "\n");
}

/* ---- fields ---------------------------------------------------------------------------------- */

static const char *type_name(enum registers_type type) {
  static const char *const names[] = {"uint16", "uint32", "float32", "float64", "text", "uint16"};
  return names[type];
}

static void print_type(const registers_field *field, char cell[CELL_BYTES]) {
  const bool has_unit = field->unit[0] != '\0' && strcmp(field->unit, "1") != 0;
  char count[16] = "";
  if (field->count > 1) {
    snprintf(count, sizeof count, "[%u]", field->count);
  }
  snprintf(cell, CELL_BYTES, "%s%s%s%s", type_name(field->type), count, has_unit ? ", " : "",
           has_unit ? field->unit : "");
}

static const char *list_name(const core_choice *list) {
  return list == core_models         ? "models"
         : list == core_evaluators   ? "evaluators"
         : list == core_moments_list ? "moments"
         : list == core_draws        ? "draws"
         : list == core_lengths      ? "lengths"
         : list == core_fit_axes     ? "axes"
         : list == core_fit_scales   ? "scales"
                                     : "spacings";
}

static void print_range(const registers_field *field, char cell[CELL_BYTES]) {
  if (field->list != NULL) {
    const char *name = list_name(field->list);
    snprintf(cell, CELL_BYTES, "%s[%s](#lists)", field->least == 0 ? "0, " : "", name);
  } else if (field->type == REGISTERS_BITS) {
    registers_bits_text(field, cell, CELL_BYTES);
  } else if (field->least == 0 && field->most == 0) {
    cell[0] = '\0';
  } else if (field->most == (double)FLT_MAX) {
    snprintf(cell, CELL_BYTES, "%.8g, finite", field->least);
  } else {
    const int digits = registers_digits(field->type);
    snprintf(cell, CELL_BYTES, "%.*g to %.*g", digits, field->least, digits, field->most);
  }
}

static void print_default(const registers_field *field, char cell[CELL_BYTES]) {
  if (field->access == REGISTERS_OPTIONAL) {
    snprintf(cell, CELL_BYTES, "%g, not given", field->initial);
  } else if (field->type == REGISTERS_TEXT) {
    snprintf(cell, CELL_BYTES, "empty");
  } else if (isnan(field->initial)) {
    snprintf(cell, CELL_BYTES, "NaN");
  } else {
    snprintf(cell, CELL_BYTES, "%.10g", field->initial);
  }
}

static void describe_field(const struct description *to, const registers_field *field) {
  char row[ROW_BYTES], type[CELL_BYTES], range[CELL_BYTES], initial[CELL_BYTES];
  char written[2 * CELL_BYTES + 4] = "";
  print_type(field, type);
  if (field->access != REGISTERS_RO) {
    print_range(field, range);
    print_default(field, initial);
    snprintf(written, sizeof written, "%s (%s)", range, initial);
  }
  snprintf(row, sizeof row, "| %u | %s | %s | %s | %s |\n", field->address, field->name, type,
           written, field->about);
  to->print(to->context, row);
}

/* Returns the first field of a block that starts at `from` or after it; NULL if there is none. */
static const registers_field *next_field(const registers_block *block, unsigned from) {
  const registers_field *next = NULL;
  for (const registers_field *field = registers_fields; field->name != NULL; field++) {
    if (field->address >= from && field->address < block->first + block->length &&
        (next == NULL || field->address < next->address)) {
      next = field;
    }
  }
  return next;
}

static void describe_fields(const struct description *to) {
  for (unsigned i = 0; i < REGISTERS_BLOCKS; i++) {
    const registers_block *block = &registers_blocks[i];
    if (is_mirror(block)) {
      continue;
    }
    char name[CELL_BYTES];
    snprintf(name, sizeof name, "Block %u: %s", block->id, block->name);
    title(to, name, "PDU | name | type, unit | range (default) | meaning");
    const registers_field *field;
    for (unsigned from = block->first; (field = next_field(block, from)) != NULL;
         from = field->address + 1) {
      if (!is_of_jobs(field)) {
        describe_field(to, field);
      }
    }
    to->print(to->context, "\n");
  }
}

/* ---- lists ----------------------------------------------------------------------------------- */

static void describe_list(const struct description *to, const char *name, const core_choice *list) {
  char text[CELL_BYTES];
  snprintf(text, sizeof text, "| %s |", name);
  to->print(to->context, text);
  for (const core_choice *choice = list; choice->name != NULL; choice++) {
    snprintf(text, sizeof text, "%s %u %s", choice == list ? "" : ",", choice->id, choice->name);
    to->print(to->context, text);
  }
  to->print(to->context, " |\n");
}

static void describe_errors(const struct description *to) {
  to->print(to->context, "| errors (exceptions) |");
  const char *before = "";
  char text[CELL_BYTES];
#define WIRE_STATUS(code, IDENT, modbus_exception, http, name, text_)                              \
  snprintf(text, sizeof text, "%s %d %s (%02x)", before, code, name,                               \
           (unsigned)(modbus_exception));                                                          \
  to->print(to->context, text);                                                                    \
  before = ",";
#include "proto/statuses.def"
#undef WIRE_STATUS
  to->print(to->context, " |\n");
}

void registers_describe(void (*print)(void *context, const char *text), void *context) {
  const struct description to = {print, context};
  describe_blocks(&to);
  describe_jobs(&to);
  describe_fields(&to);
  title(&to, "Lists", "list | ids and names");
  describe_list(&to, "models", core_models);
  describe_list(&to, "evaluators", core_evaluators);
  describe_list(&to, "moments", core_moments_list);
  describe_list(&to, "spacings", core_spacings);
  describe_list(&to, "draws", core_draws);
  describe_list(&to, "lengths", core_lengths);
  describe_list(&to, "phases", core_phases);
  describe_list(&to, "axes", core_fit_axes);
  describe_list(&to, "scales", core_fit_scales);
  describe_list(&to, "fit statuses", core_fit_statuses);
  describe_list(&to, "notes", core_notes);
  describe_errors(&to);
  to.print(to.context, "\n");
}
