/* wire-lists: prints the lists of the wire, of the register map and of SCPI as JSON, for wire_tables.py. NaN
 * and Infinity are numbers there. */
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "core/tissue/tissue.h"
#include "core/varying.h"
#include "proto/registers.h"
#include "proto/schema.h"

/* Prints JSON, where ' stands for ", %s for a text or null, %r for a text without quotes, %u for an
 * integer and %g for a number. */
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
    } else if (*form == 'r') {
      fputs(va_arg(arguments, const char *), stdout);
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

/* Returns the name of a list; NULL if it is none. */
static const char *name_of(const core_choice *list) {
#define WIRE_LIST(kind, IDENT, name, plural, choices)                                              \
  if (list == (choices)) {                                                                         \
    return name;                                                                                   \
  }
#include "proto/messages.def"
  return NULL;
}

static void put_list(unsigned kind, const char *name, const core_choice *list) {
  print_form(kind > 1 ? ",[%u,%s,[" : "[%u,%s,[", U(kind), name);
  for (const core_choice *one = list; one->name != NULL; one++) {
    print_form(one > list ? ",[%u,%s]" : "[%u,%s]", U(one->id), one->name);
  }
  print_form("]]");
}

static void put_registers(void) {
  static const char *const types[] = {"uint16", "uint32", "float32", "float64", "text", "uint16"};
  print_form("'mirror':%u,'most':%g,'blocks':[", U(REGISTERS_MIRROR), (double)FLT_MAX);
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
    print_form(",%u,%u]", U(job->progress), U(job->error_text));
  }
  print_form("],'registers':[");
  for (const registers_field *field = registers_fields; field->name != NULL; field++) {
    char bits[80] = "";
    if (field->type == REGISTERS_BITS) {
      registers_bits_text(field, bits, sizeof bits);
    }
    print_form(field > registers_fields ? ",{" : "{");
    print_form(
        "'address':%u,'count':%u,'type':%s,'access':%u,'name':%s,'unit':%s,'least':%g,'most':%g,"
        "'digits':%u,'bits':%s,'list':%s,'initial':%g,'about':%s}",
        U(field->address), U(field->count), types[field->type], U(field->access), field->name,
        field->unit, field->least, field->most, U(registers_digits(field->type)), bits,
        name_of(field->list), field->initial, field->about);
  }
  print_form("],");
}

static void put_spectra(void) {
  const char *between = "";
#define ANY "all"
#define PRAHL "prahl"
#define UCL "ucl"
#define CORE_SPECTRUM(PROPERTY, HAEMOGLOBIN, from_nm, to_nm, factor, source, ...)                  \
  print_form("%r[%s,%u,%u,%s,%s]", between,                                                        \
             core_choice_by_id(core_properties, CORE_PROPERTY_##PROPERTY)->name, U(from_nm),       \
             U(to_nm), source, HAEMOGLOBIN);                                                       \
  between = ",";
#define CORE_FORMULA(PROPERTY, from_nm, to_nm, per_mm, source)                                     \
  CORE_SPECTRUM(PROPERTY, ANY, from_nm, to_nm, 1, source, 0)
  print_form("'spectra':[");
#include "core/tissue/spectra.def"
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
      print_form("'bits':%u,'list':%s,'default':%g,", U(field->bits), name_of(field->list), field->usual);
      print_form("'name':%s,'kind':%s,'count':%u,'bytes':%u,'meaning':%s,'unit':%s,'usual':%s,"
                 "'usual_number':%g,'least':%g,'most':%g}",
                 field->name, schema_kind_name(field->kind), U(field->count), U(field->bytes),
                 field->meaning, field->unit, usual != NULL && !field->bits ? usual->name : NULL,
                 field->list == NULL ? field->usual : 0, spans ? field->least : 0,
                 spans ? field->most : 0);
    }
    print_form("]");
  }
  print_form("},");
}

static void put_number(const schema_number *number) {
  print_form(number->mask != 0 ? "%r&%u" : "%r", number->name, U(number->mask));
}

/* Puts a product of numbers in brackets; nothing if there is no factor. */
static void put_product(const schema_number *numbers, unsigned times, unsigned more) {
  for (int i = 0; i < SCHEMA_FACTORS && numbers[i].name != NULL; i++) {
    print_form(i > 0 ? "*" : "[");
    put_number(&numbers[i]);
  }
  if (numbers[0].name != NULL) {
    print_form(times > 0 ? "*%u" : "", U(times));
    print_form(more > 0 ? "+%u]" : "]", U(more));
  }
}

/* Puts a payload as clients/python/dipole/schema.py has it. */
static void put_payload(const schema_payload *payload) {
  print_form("%s:'%r", payload->name, payload->structures[0]->name);
  if (payload->structures[1] != NULL) {
    print_form("; %r", payload->structures[1]->name);
  }
  for (const schema_part *part = payload->parts; part->name != NULL; part++) {
    if (part->never) {
      continue;
    }
    print_form("; %r %r",
               part->kind == SCHEMA_LIST ? part->structure->name : schema_kind_name(part->kind),
               part->name);
    put_product(part->arrays, 0, 0);
    put_product(part->count, part->times, part->more);
    print_form(part->rest ? "[]" : "");
    if (part->when.name != NULL) {
      print_form(part->unless ? " unless " : " if ");
      put_number(&part->when);
      print_form(" is %u", U(part->is));
    }
  }
  print_form("',");
}

/* Puts a command of SCPI. TAKE is a query. */
static void put_command(const char *pattern, unsigned forms, const char *parameters,
                        const char *about) {
  print_form("[%s,%s,%s,%s],", pattern,
             forms == 1   ? ""
             : forms == 3 ? " (?)"
                          : "?",
             parameters, about);
}

static void put_scpi(void) {
  enum { SET = 1, QUERY, BOTH, TAKE };
  print_form("'scpi':[");
#define SCPI_ROW(...) put_command(__VA_ARGS__);
#include "proto/scpi.def"
  print_form("0],");
}

int main(void) {
  print_form("{");
  put_registers();
  put_spectra();
  put_structures();
  put_scpi();
  print_form("'messages':{");
#define WIRE_MESSAGE(type, IDENT, name, ROLE, LATENCY, request, reply, about)                      \
  print_form("'" name "':[%u,'" #request "','" #reply "'],", U(type));
#include "proto/messages.def"
  print_form("'':0},'lists':[");
#define WIRE_LIST(kind, IDENT, name, plural, list) put_list(kind, name, list);
#include "proto/messages.def"
  print_form("],'statuses':[");
#define WIRE_STATUS(code, IDENT, modbus_exception, http, scpi, name, text)                         \
  print_form("[%u,'" #IDENT "',%u,%u,'" name "'],", U(code), U(modbus_exception), U(http));
#include "proto/statuses.def"
  print_form("0],'quantities':[");
#define QUANTITY(P, bit, IDENT, name, unit, SHAPE, about)                                          \
  print_form("[%u,'" #IDENT "',%s,%s,'" #SHAPE "',%s],", U(bit), name, unit, about);
  CORE_EACH_QUANTITY(QUANTITY, )
  print_form("0],'payloads':{");
#define WIRE_PAYLOAD(name, ...) put_payload(&schema_##name);
#include "proto/messages.def"
  print_form("'':0}}\n");
  return fflush(stdout) == 0 ? 0 : 1;
}
