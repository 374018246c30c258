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

static void describe_blocks(const struct description *to) {
  title(to, "Blocks", "id | PDU | 4xxxx | registers | name | what it is");
  for (const registers_block *block = registers_blocks; block < registers_blocks + REGISTERS_BLOCKS;
       block++) {
    char row[ROW_BYTES];
    const unsigned last = block->first + block->length - 1;
    snprintf(row, sizeof row, "| %u | %u to %u | %u to %u | %u | %s | %s |\n", block->id,
             block->first, last, 40001 + block->first, 40001 + last, block->length, block->name,
             block->about);
    to->print(to->context, row);
  }
  to->print(to->context, "\n");
}

/* ---- fields ---------------------------------------------------------------------------------- */

static const char *type_name(enum registers_type type) {
  static const char *const names[] = {"uint16", "uint32", "float32", "float64", "text", "uint16"};
  return names[type];
}

static void print_type(const registers_field *field, char cell[CELL_BYTES]) {
  if (field->count == 1) {
    snprintf(cell, CELL_BYTES, "%s", type_name(field->type));
  } else {
    snprintf(cell, CELL_BYTES, "%s[%u]", type_name(field->type), field->count);
  }
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
    snprintf(cell, CELL_BYTES, "%sone of [%s](#%s)", field->least == 0 ? "0, or " : "", name, name);
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
    snprintf(cell, CELL_BYTES, "%g: not given", field->initial);
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
  const bool changes = field->access != REGISTERS_RO || field->initial != 0;
  print_type(field, type);
  print_range(field, range);
  print_default(field, initial);
  snprintf(row, sizeof row, "| %u | %u | %s | %s | %s | %s | %s | %s | %s |\n", field->address,
           40001 + field->address, field->name, type, field->unit,
           field->access == REGISTERS_RO ? "R" : "RW", range, changes ? initial : "", field->about);
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
    if (block->first / REGISTERS_MIRROR % 2 == 1) { /* The block is a mirror. */
      continue;
    }
    char name[CELL_BYTES];
    snprintf(name, sizeof name, "Block %u: %s", block->id, block->name);
    title(to, name, "PDU | 4xxxx | name | type | unit | access | range | default | meaning");
    const registers_field *field;
    for (unsigned from = block->first; (field = next_field(block, from)) != NULL;
         from = field->address + 1) {
      describe_field(to, field);
    }
    to->print(to->context, "\n");
  }
}

/* ---- lists ----------------------------------------------------------------------------------- */

/* Writes text for a cell of a Markdown table, in which "|" has to be escaped. */
static void escape(const char *text, char *cell, size_t room) {
  size_t length = 0;
  for (; *text != '\0' && length + 2 < room; text++) {
    if (*text == '|') {
      cell[length++] = '\\';
    }
    cell[length++] = *text;
  }
  cell[length] = '\0';
}

static void describe_list(const struct description *to, const char *name, const core_choice *list) {
  title(to, name, "id | name | what it is");
  for (const core_choice *choice = list; choice->name != NULL; choice++) {
    char row[ROW_BYTES], about[ROW_BYTES / 2];
    escape(choice->about, about, sizeof about);
    snprintf(row, sizeof row, "| %u | %s | %s |\n", choice->id, choice->name, about);
    to->print(to->context, row);
  }
  to->print(to->context, "\n");
}

static void describe_errors(const struct description *to) {
  title(to, "Errors", "error | name | exception | meaning");
  char row[ROW_BYTES];
#define WIRE_STATUS(code, IDENT, modbus_exception, http, name, text)                               \
  snprintf(row, sizeof row, "| %d | %s | %02x | %s |\n", code, name, (unsigned)(modbus_exception), \
           text);                                                                                  \
  to->print(to->context, row);
#include "proto/statuses.def"
#undef WIRE_STATUS
  to->print(to->context, "\n");
}

void registers_describe(void (*print)(void *context, const char *text), void *context) {
  const struct description to = {print, context};
  describe_blocks(&to);
  describe_fields(&to);
  describe_list(&to, "Models", core_models);
  describe_list(&to, "Evaluators", core_evaluators);
  describe_list(&to, "Moments", core_moments_list);
  describe_list(&to, "Spacings", core_spacings);
  describe_list(&to, "Draws", core_draws);
  describe_list(&to, "Lengths", core_lengths);
  describe_list(&to, "Phases", core_phases);
  describe_list(&to, "Axes", core_fit_axes);
  describe_list(&to, "Scales", core_fit_scales);
  describe_list(&to, "Fit statuses", core_fit_statuses);
  describe_list(&to, "Notes", core_notes);
  describe_errors(&to);
}
