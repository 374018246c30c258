/* wire-lists: prints the lists of the wire and of the register map as JSON, for wire_tables.py. NaN
 * and Infinity are numbers there. */
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "proto/registers.h"
#include "proto/schema.h"

/* Prints JSON, where ' stands for ", %s for a text or null, %u for an integer and %g for a number. */
static void print_form(const char *form, ...) {
  va_list arguments;
  va_start(arguments, form);
  for (; *form != '\0'; form++) {
    if (*form != '%') {
      putchar(*form == '\'' ? '"' : *form);
    } else if (*++form == 'u') {
      printf("%llu", va_arg(arguments, unsigned long long));
    } else if (*form == 'g') {
      const double number = va_arg(arguments, double);
      printf(isnan(number) ? "NaN" : isinf(number) ? "Infinity" : "%.17g", number);
    } else {
      const char *text = va_arg(arguments, const char *);
      for (printf(text != NULL ? "\"" : "null"); text != NULL && *text != '\0'; text++) {
        printf(strchr("\"\\", *text) != NULL ? "\\%c" : "%c", *text);
      }
      printf(text != NULL ? "\"" : "");
    }
  }
  va_end(arguments);
}

#define U(number) ((unsigned long long)(number))

static const struct {
  const char *name;
  const core_choice *list;
} lists[] = {{"models", core_models},        {"evaluators", core_evaluators},
             {"moments", core_moments_list}, {"spacings", core_spacings},
             {"draws", core_draws},          {"lengths", core_lengths},
             {"phases", core_phases},        {"axes", core_fit_axes},
             {"scales", core_fit_scales},    {"fit statuses", core_fit_statuses},
             {"notes", core_notes}};
enum { LISTS = sizeof lists / sizeof lists[0] };

static void put_registers(void) {
  static const char *const types[] = {"uint16", "uint32", "float32", "float64", "text", "uint16"};
  print_form("'lists':{");
  for (int i = 0; i < LISTS; i++) {
    print_form(i > 0 ? ",%s:[" : "%s:[", lists[i].name);
    for (const core_choice *one = lists[i].list; one->name != NULL; one++) {
      print_form(one > lists[i].list ? ",[%u,%s]" : "[%u,%s]", U(one->id), one->name);
    }
    print_form("]");
  }
  print_form("},'mirror':%u,'most':%g,'blocks':[", U(REGISTERS_MIRROR), (double)FLT_MAX);
  for (int i = 0; i < REGISTERS_BLOCKS; i++) {
    const registers_block *block = &registers_blocks[i];
    print_form(i > 0 ? ",[%u,%u,%u,%s,%s]" : "[%u,%u,%u,%s,%s]", U(block->id), U(block->first),
               U(block->length), block->name, block->about);
  }
  print_form("],'jobs':[");
  for (int i = 0; i < REGISTERS_JOBS; i++) {
    const registers_job *job = &registers_jobs[i];
    print_form(i > 0 ? ",[%u,%u,%u,%u" : "[%u,%u,%u,%u", U(job->commit), U(job->cancel),
               U(job->deadline), U(job->status));
    for (unsigned behind = REGISTERS_BEHIND_DONE; behind <= REGISTERS_BEHIND_COUNT; behind++) {
      print_form(",%u", U(job->status + behind));
    }
    print_form(",%u,%u,%u]", U(job->place), U(job->progress), U(job->error_text));
  }
  print_form("],'registers':[");
  for (const registers_field *field = registers_fields; field->name != NULL; field++) {
    const char *list = NULL;
    char bits[80] = "";
    for (int i = 0; i < LISTS; i++) {
      list = lists[i].list == field->list ? lists[i].name : list;
    }
    if (field->type == REGISTERS_BITS) {
      registers_bits_text(field, bits, sizeof bits);
    }
    print_form(field > registers_fields ? ",{" : "{");
    print_form(
        "'address':%u,'count':%u,'type':%s,'access':%u,'name':%s,'unit':%s,'least':%g,'most':%g,"
        "'digits':%u,'bits':%s,'list':%s,'initial':%g,'about':%s}",
        U(field->address), U(field->count), types[field->type], U(field->access), field->name,
        field->unit, field->least, field->most, U(registers_digits(field->type)), bits, list,
        field->initial, field->about);
  }
  print_form("],");
}

static void put_structures(void) {
  print_form("'structures':{");
  for (int i = 0; i < SCHEMA_STRUCTURES; i++) {
    const schema_structure *structure = &schema_structures[i];
    print_form(i > 0 ? ",%s:[" : "%s:[", structure->name);
    for (const schema_field *field = structure->fields; field->name != NULL; field++) {
      const core_choice *usual =
          field->list != NULL ? core_choice_by_id(field->list, (unsigned)field->usual) : NULL;
      const bool spans = field->spans && field->list == NULL;
      print_form(field > structure->fields ? ",{" : "{");
      print_form("'name':%s,'kind':%s,'count':%u,'bytes':%u,'meaning':%s,'unit':%s,'usual':%s,"
                 "'usual_number':%g,'least':%g,'most':%g}",
                 field->name, schema_kind_name(field->kind), U(field->count),
                 U(schema_field_bytes(field)), field->meaning, field->unit,
                 usual != NULL && !field->bits ? usual->name : NULL,
                 field->list == NULL ? field->usual : 0, spans ? field->least : 0,
                 spans ? field->most : 0);
    }
    print_form("]");
  }
  print_form("},");
}

static void put_numbers(const schema_number *numbers, int count) {
  for (int i = 0; i < count && numbers[i].name != NULL; i++) {
    print_form(i > 0 ? ",[%s,%u]" : "[%s,%u]", numbers[i].name, U(numbers[i].mask));
  }
}

static void put_payload(const schema_payload *payload) {
  print_form("%s:{'structures':[", payload->name);
  for (int i = 0; i < 2 && payload->structures[i] != NULL; i++) {
    print_form(i > 0 ? ",%s" : "%s", payload->structures[i]->name);
  }
  print_form("],'parts':[");
  for (const schema_part *part = payload->parts; part->name != NULL; part++) {
    print_form(part > payload->parts ? ",{" : "{");
    print_form(
        "'element':%s,'name':%s,'never':%u,'rest':%u,'times':%u,'more':%u,'unless':%u,'is':%u,",
        part->kind == SCHEMA_LIST ? part->structure->name : schema_kind_name(part->kind),
        part->name, U(part->never), U(part->rest), U(part->times), U(part->more), U(part->unless),
        U(part->is));
    print_form("'when':[");
    put_numbers(&part->when, 1);
    print_form("],'arrays':[");
    put_numbers(part->arrays, SCHEMA_FACTORS);
    print_form("],'count':[");
    put_numbers(part->count, SCHEMA_FACTORS);
    print_form("]}");
  }
  print_form("]},");
}

int main(void) {
  print_form("{");
  put_registers();
  put_structures();
  print_form("'messages':{");
#define WIRE_MESSAGE(type, IDENT, name, ...) print_form("'" name "':%u,", U(type));
#include "proto/messages.def"
  print_form("'':0},'kinds':{");
#define WIRE_LIST(kind, IDENT, name, list) print_form("'%u':'" name "',", U(kind));
#include "proto/messages.def"
  print_form("'':0},'statuses':[");
#define WIRE_STATUS(code, IDENT, modbus_exception, http, name, text)                               \
  print_form("[%u,'" #IDENT "',%u,%u,'" name "'],", U(code), U(modbus_exception), U(http));
#include "proto/statuses.def"
  print_form("0],'elementwise':[");
  for (const core_choice *one = core_quantities; one->name != NULL; one++) {
    print_form(core_quantity_elementwise(one->id) ? "%u," : "", U(one->id));
  }
  print_form("0],'payloads':{");
#define WIRE_PAYLOAD(name, ...) put_payload(&schema_##name);
#include "proto/messages.def"
  print_form("'':0}}\n");
  return fflush(stdout) == 0 ? 0 : 1;
}
