#include "clients/cli/options.h"

#include <assert.h>
#include <errno.h>
#include <getopt.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/core.h"
#include "proto/decimal.h"

#define AT(settings, option, type) ((type *)(void *)((char *)(settings) + (option)->offset))

_Static_assert(DIPOLE_TIMEOUT_MS == 30000, "say so in the help of --timeout-ms");

static const cli_option common_options[] = {
    CLI_TITLE("Options of all commands"),
    {"connect",
     "unix:PATH, tcp:HOST:PORT or tls:HOST:PORT; private: starts a private daemon. Several, "
     "separated by commas, are tried in turn (default: the environment variable DIPOLED, else "
     "private:; for info and bench the installed service before that, if it is there)",
     CLI_TEXT, offsetof(cli_settings, connect), NULL, "ADDRESS"},
    CLI_OPTION(FILE, ca, NULL,
               "for tls: the certificates that sign the daemon's, PEM (default: the environment "
               "variable DIPOLED_CA, else those of the system)"),
    CLI_OPTION(FILE, certificate, NULL,
               "for tls: the client's certificate, PEM, if the daemon requires one (default: the "
               "environment variable DIPOLED_CERTIFICATE)"),
    CLI_OPTION(FILE, key, NULL,
               "for tls: its key (default: the environment variable DIPOLED_KEY, else in the file "
               "of the certificate)"),
    {"format", NULL, CLI_TEXT, offsetof(cli_settings, format), NULL, "FORMAT"},
    CLI_OPTION(COUNT32, timeout_ms, CORE_TEXT(30000),
               "give up if the daemon is silent for N ms; 0: never"),
    CLI_OPTION(COUNT32, retry_ms, NULL,
               "retry for N ms if no daemon replies, or if it is lost or busy; 0: do not retry "
               "(default: 5000; while it is busy: --timeout-ms, if that is more)"),
    {"help", "print this text", CLI_SWITCH, 0, NULL, NULL},
    {0},
};

/* ---- the options of a command ---------------------------------------------------------------- */

enum { OPTIONS_MAX = 64, NAME_BYTES = 32 };

/* Returns whether a parameter is the name of a choice: its unit is "id". */
static bool is_name(const core_choice *parameter) {
  return strncmp(parameter->about, "id: ", strlen("id: ")) == 0;
}

/* Makes an option of a parameter: its text has no unit 1 or id, and no range of ids. */
static cli_option option_of(const core_choice *parameter) {
  static char without_range[CORE_PARAMETERS_END][64];
  const char *about = strchr(parameter->about, ':') + 2;
  if (is_name(parameter)) {
    char *text = without_range[parameter->id];
    snprintf(text, sizeof without_range[0], "%.*s", (int)(strrchr(about, '(') - 1 - about), about);
    about = text;
  }
  return (cli_option){.name = parameter->name,
                      .argument = is_name(parameter) ? "NAME" : "X",
                      .help = is_name(parameter) || parameter->about[0] == '1' ? about
                                                                               : parameter->about,
                      .kind = CLI_PARAMETER,
                      .offset = offsetof(cli_settings, parameters[parameter->id])};
}

/* A list of options that is being made. */
typedef struct option_list {
  size_t count;
  cli_option items[OPTIONS_MAX + 1];
  char names[OPTIONS_MAX][NAME_BYTES];
} option_list;

/* Adds an option with - for _ in its name, and with the argument of its kind. */
static void add_option(option_list *list, cli_option option) {
  static const char *const arguments[] = {
      [CLI_TEXT] = "NAME",  [CLI_FILE] = "FILE",         [CLI_COUNT] = "N",
      [CLI_COUNT32] = "N",  [CLI_NUMBER] = "X",          [CLI_ONE] = "X",
      [CLI_NAME] = "NAME",  [CLI_NUMBERS] = "X[,X...]",  [CLI_NAMES] = "NAME[,NAME...]",
      [CLI_FILES] = "FILE", [CLI_PARAMETER] = "unknown",
  };
  assert(list->count < OPTIONS_MAX);
  if (option.kind != CLI_HEADING) {
    char *name = list->names[list->count];
    snprintf(name, NAME_BYTES, "%s", option.name);
    for (char *dash; (dash = strchr(name, '_')) != NULL;) {
      *dash = '-';
    }
    option.name = name;
    option.argument = option.argument != NULL ? option.argument : arguments[option.kind];
  }
  list->items[list->count++] = option;
}

static void add_list(option_list *list, const cli_option *options) {
  for (; options != NULL && options->name != NULL; options++) {
    add_option(list, *options);
  }
}

const cli_option *cli_options_of(const cli_command *command) {
  static option_list list;
  static const cli_command *listed;
  if (command == listed) {
    return list.items;
  }
  listed = command;
  list.count = 0;
  for (size_t i = 0; i < CLI_LISTS_MAX; i++) {
    add_list(&list, command->options[i]);
  }
  if (command->parameters != 0) {
    add_option(&list, (cli_option)CLI_TITLE("Parameters, for the models that take them"));
  }
  for (unsigned id = 1; id < CORE_PARAMETERS_END; id++) {
    const core_choice *parameter = core_choice_by_id(core_parameter_list, id);
    if (parameter != NULL && (command->parameters & 1U << id) != 0) {
      add_option(&list, option_of(parameter));
    }
  }
  add_list(&list, common_options);
  list.items[list.count] = (cli_option){0};
  return list.items;
}

/* ---- looking up ------------------------------------------------------------------------------ */

/* Fields of requests whose options have other names. */
static const struct {
  const char *field, *option;
} renamed[] = {{"radius_start", "from"},       {"radius_stop", "to"},
               {"radius_count", "count"},      {"sample_count", "count"},
               {"sample_first", "first"},      {"ring_count", "rings"},
               {"error_rings", "error"},       {"albedo_count", "albedo"},
               {"error_total", "total-error"}, {"wavelength", "wavelengths"}};

/* Returns whether an option has the name of a field, where - stands for _. */
static bool is_same_name(const char *option, const char *field) {
  while (*option != '\0' && *option == (*field == '_' ? '-' : *field)) {
    option++;
    field++;
  }
  return *option == *field;
}

const cli_option *cli_options_find(const char *field) {
  const cli_option *option = cli_options_of(cli_running());
  for (size_t i = 0; i < sizeof renamed / sizeof renamed[0]; i++) {
    if (strcmp(renamed[i].field, field) == 0) {
      field = renamed[i].option;
    }
  }
  while (option->name != NULL &&
         (option->kind == CLI_HEADING || !is_same_name(option->name, field))) {
    option++;
  }
  return option->name != NULL ? option : NULL;
}

double cli_numbers_pick(const cli_numbers *numbers, size_t channel, double otherwise) {
  assert(numbers->count <= 1 || channel < numbers->count);
  return numbers->count == 0 ? otherwise : numbers->items[numbers->count == 1 ? 0 : channel];
}

const void *cli_numbers_in(const cli_numbers *numbers, bool single) {
  float *floats = single ? cli_allocate(numbers->count, sizeof *floats) : NULL;
  for (size_t i = 0; single && i < numbers->count; i++) {
    floats[i] = (float)numbers->items[i];
  }
  return single ? (const void *)floats : numbers->items;
}

bool cli_texts_have(const cli_texts *texts, const char *text) {
  for (size_t i = 0; i < texts->count; i++) {
    if (strcmp(texts->items[i], text) == 0) {
      return true;
    }
  }
  return false;
}

/* ---- values ---------------------------------------------------------------------------------- */

static void add_text(cli_texts *texts, const char *text, size_t length) {
  texts->items = cli_resize(texts->items, texts->count + 1, sizeof *texts->items);
  texts->items[texts->count++] = cli_copy(text, length);
}

/* Splits a text at its commas: "a,b" gives two parts, "" gives one empty part. */
static void split(const char *text, cli_texts *parts) {
  parts->count = 0;
  parts->whole = text;
  for (const char *comma; (comma = strchr(text, ',')) != NULL; text = comma + 1) {
    add_text(parts, text, (size_t)(comma - text));
  }
  add_text(parts, text, strlen(text));
}

/* Reads a whole text of decimal digits. */
static bool read_count(const char *text, uint64_t *value) {
  errno = 0;
  *value = strtoull(text, NULL, 10);
  return text[0] != '\0' && text[strspn(text, "0123456789")] == '\0' && errno == 0;
}

#define DECIMAL_POINT "number: write a decimal point, as in 0.05"

/* Says what is expected in place of a text that decimal_read() refuses. */
static const char *expected_number(const char *text) {
  return isinf(strtod(text, NULL)) ? "number up to 1.8e308" : "decimal number";
}

/* These return NULL, or what is expected if it is wrong. */
static const char *read_number(const char *text, double *number) {
  return decimal_read(text, number)  ? NULL
         : strchr(text, ',') != NULL ? DECIMAL_POINT
                                     : expected_number(text);
}

static const char *read_numbers(const char *text, cli_numbers *numbers) {
  cli_texts parts = {0};
  const char *expected = NULL;
  split(text, &parts);
  numbers->items = cli_resize(numbers->items, parts.count, sizeof *numbers->items);
  numbers->count = parts.count;
  for (size_t i = 0; i < parts.count; i++) {
    if (!decimal_read(parts.items[i], &numbers->items[i])) {
      expected = parts.count > 1 ? "list of decimal numbers up to 1.8e308" : expected_number(text);
    } else if (decimal_starts_with_zero(parts.items[i])) {
      expected = "list of numbers: one of them starts with a 0; write a decimal point, as in 0.05";
    }
  }
  return expected;
}

/* Stores the value of an option. Returns NULL, or what kind of value is expected if it is wrong. */
static const char *take_value(const cli_option *option, const char *text, bool given,
                              cli_settings *settings) {
  switch (option->kind) {
  case CLI_SWITCH:
    *AT(settings, option, bool) = true;
    return NULL;
  case CLI_TEXT:
  case CLI_FILE:
    *AT(settings, option, const char *) = text;
    return NULL;
  case CLI_COUNT:
  case CLI_COUNT32:
    AT(settings, option, cli_count)->given = given;
    return !read_count(text, &AT(settings, option, cli_count)->value) ? "whole number"
           : option->kind == CLI_COUNT32 && AT(settings, option, cli_count)->value > UINT32_MAX
               ? "whole number up to 4294967295"
               : NULL;
  case CLI_NUMBER:
    AT(settings, option, cli_number)->given = given;
    return read_number(text, &AT(settings, option, cli_number)->value);
  case CLI_PARAMETER:
    AT(settings, option, cli_given)->text = text;
    return option->argument[0] == 'N' ? NULL
                                      : read_number(text, &AT(settings, option, cli_given)->value);
  case CLI_ONE:
    return strchr(text, ',') != NULL ? DECIMAL_POINT
                                     : read_numbers(text, AT(settings, option, cli_numbers));
  case CLI_NUMBERS:
    return read_numbers(text, AT(settings, option, cli_numbers));
  case CLI_NAMES:
    split(text, AT(settings, option, cli_texts));
    return NULL;
  case CLI_NAME:
    AT(settings, option, cli_texts)->count = 0;
    __attribute__((fallthrough));
  case CLI_FILES:
    add_text(AT(settings, option, cli_texts), text, strlen(text));
    return NULL;
  case CLI_HEADING:
    break;
  }
  return NULL;
}

/* ---- the command line ------------------------------------------------------------------------ */

bool cli_in_list(const char *list, const char *name) {
  const size_t length = strlen(name);
  for (const char *at = list; length > 0 && (at = strstr(at, name)) != NULL; at++) {
    if ((at == list || at[-1] == ',') && (at[length] == ',' || at[length] == '\0')) {
      return true;
    }
  }
  return false;
}

static enum cli_form form_of(const char *format) {
  static const char *const names[] = {
      [CLI_NONE] = "none", [CLI_TABLE] = "table", [CLI_CSV] = "csv", [CLI_JSON] = "json"};
  enum cli_form form = CLI_JSON;
  while (form > CLI_NONE && strncmp(format, names[form], strlen(names[form])) != 0) {
    form--;
  }
  return form;
}

enum { FORMATS_BYTES = 96 };

/* Writes the formats of a command as a sentence. */
static void say_formats(const cli_command *command, char text[FORMATS_BYTES]) {
  const char *formats = command->formats;
  if (strchr(formats, ',') != NULL) {
    snprintf(text, FORMATS_BYTES, "one of %s (default: %.*s)", formats, (int)strcspn(formats, ","),
             formats);
  } else {
    snprintf(text, FORMATS_BYTES, "only %s%s", formats,
             strcmp(formats, "none") == 0 ? ", as images are written" : "");
  }
}

/* Reads the operand and the format, and checks what getopt does not. Returns an exit status. */
static int finish_options(int argc, char **argv, cli_settings *settings) {
  const cli_command *command = cli_running();
  const int operands = (command->operand != NULL) + (command->second_operand != NULL);
  settings->operand = optind < argc ? argv[optind] : NULL;
  settings->second_operand = optind + 1 < argc ? argv[optind + 1] : NULL;
  if (argc - optind > operands) {
    return cli_fail_usage("'%s' is one argument too many: leave it out", argv[optind + operands]);
  }
  if (settings->format != NULL && !cli_in_list(command->formats, settings->format)) {
    char formats[FORMATS_BYTES];
    say_formats(command, formats);
    return cli_fail_usage("--format %s: %s", settings->format, formats);
  }
  for (size_t i = 0; i < settings->f.count; i++) {
    if (!(settings->f.items[i] >= 0)) {
      return cli_fail_usage("--f: %g is no spatial frequency: give 0 or more, in 1/mm",
                            settings->f.items[i]);
    }
  }
  settings->form = form_of(settings->format != NULL ? settings->format : command->formats);
  return CLI_OK;
}

/* Returns false if the command ends here; *status is then its exit status. */
static bool take_option(const cli_option *option, cli_settings *settings, int *status) {
  if (strcmp(option->name, "help") == 0) {
    cli_options_help(cli_running());
    *status = CLI_OK;
    return false;
  }
  if (!cli_in_list("mci,tolerance,format,connect,ca,certificate,key,timeout-ms,retry-ms",
                   option->name)) {
    settings->not_for_mci = option->name;
  }
  const char *expected = take_value(option, optarg, true, settings);
  if (expected != NULL) {
    *status = cli_fail_usage("--%s: '%s' is no %s", option->name, optarg, expected);
  }
  return expected == NULL;
}

void cli_nearest_try(cli_nearest *so_far, const char *name, const char *known, size_t most) {
  const unsigned distance = core_name_distance(name, known);
  if (distance <= most && (so_far->name == NULL || distance < so_far->distance)) {
    *so_far = (cli_nearest){known, distance};
  }
}

/* Refuses an option that the command does not have: --NAME or --NAME=VALUE. */
static int fail_unknown(const char *given, const cli_option *options) {
  char name[64];
  cli_nearest nearest = {0};
  snprintf(name, sizeof name, "%.*s", (int)strcspn(given, "="), given);
  for (; options->name != NULL; options++) {
    if (options->kind != CLI_HEADING) {
      cli_nearest_try(&nearest, name + strspn(name, "-"), options->name,
                      1 + strlen(options->name) / 4);
    }
  }
  return nearest.name != NULL
             ? cli_fail_usage("%s: no such option; the nearest is --%s", given, nearest.name)
             : cli_fail_usage("%s: no such option", given);
}

/* getopt returns FIRST_RESULT + i for option i. No character has such a number. */
enum { FIRST_RESULT = 256 };

bool cli_options_read(int argc, char **argv, cli_settings *settings, int *status) {
  struct option list[OPTIONS_MAX + 1] = {0};
  const cli_option *all = cli_options_of(cli_running());
  for (size_t i = 0, filled = 0; all[i].name != NULL; i++) {
    if (all[i].kind != CLI_HEADING) {
      list[filled++] =
          (struct option){all[i].name, all[i].kind != CLI_SWITCH, NULL, FIRST_RESULT + (int)i};
    }
    if (all[i].usual != NULL) {
      take_value(&all[i], all[i].usual, false, settings);
    }
  }
  opterr = 0;
  for (;;) {
    int result = getopt_long(argc, argv, ":", list, NULL);
    if (result == -1) {
      *status = finish_options(argc, argv, settings);
      return *status == CLI_OK;
    }
    if (result == '?' && optopt != 0 && optopt < FIRST_RESULT) {
      *status = cli_fail_usage("-%c: no such option", optopt);
      return false;
    }
    if (result < FIRST_RESULT) {
      *status = result == ':' ? cli_fail_usage("%s: a value is missing", argv[optind - 1])
                              : fail_unknown(argv[optind - 1], all);
      return false;
    }
    if (!take_option(&all[result - FIRST_RESULT], settings, status)) {
      return false;
    }
  }
}

/* ---- help ------------------------------------------------------------------------------------ */

enum { HELP_COLUMN = 24, HELP_WIDTH = 98 };

/* Prints words in lines that begin at `column`. cursor: the present column. */
static void print_words(int cursor, int column, const char *text) {
  bool first = true;
  while (*text != '\0') {
    const int length = (int)strcspn(text, " ");
    const bool fits = cursor + 1 + length <= HELP_WIDTH;
    if (!first && !fits) {
      putchar('\n');
    }
    const int blanks = first ? column - cursor : fits ? 1 : column;
    cursor = printf("%*s%.*s", blanks, "", length, text) + (first || fits ? cursor : 0);
    text += length + (text[length] == ' ');
    first = false;
  }
  putchar('\n');
}

/* Prints paragraphs, which end with a line end or the text, each behind an empty line. */
static void print_paragraphs(const char *text) {
  char *copy = cli_copy(text, strlen(text));
  for (char *rest = copy, *one; (one = strsep(&rest, "\n")) != NULL;) {
    putchar('\n');
    print_words(0, 0, one);
  }
}

/* Prints an option, its explanation and its default. */
static void print_option(const cli_option *option, const char *formats) {
  const char *help = option->help != NULL ? option->help : formats;
  char *text = NULL;
  int column = printf("  --%s%s%s", option->name, option->argument != NULL ? " " : "",
                      option->argument != NULL ? option->argument : "");
  if (column > HELP_COLUMN - 2) {
    putchar('\n');
    column = 0;
  }
  if (option->usual == NULL || asprintf(&text, "%s (default: %s)", help, option->usual) < 0) {
    text = NULL;
  }
  print_words(column, HELP_COLUMN, text != NULL ? text : help);
  free(text);
}

void cli_options_help(const cli_command *command) {
  char formats[FORMATS_BYTES];
  say_formats(command, formats);
  printf("Usage: dipole %s [OPTION]...%s%s%s%s\n\n%s.\n", command->name,
         command->operand != NULL ? " " : "", command->operand != NULL ? command->operand : "",
         command->second_operand != NULL ? " " : "",
         command->second_operand != NULL ? command->second_operand : "", command->about);
  if (command->more != NULL) {
    print_paragraphs(command->more);
  }
  for (const cli_option *option = cli_options_of(command); option->name != NULL; option++) {
    if (option->kind == CLI_HEADING) {
      printf("\n%s\n", option->name);
    } else {
      print_option(option, formats);
    }
  }
  printf("\nExit status: 0 done, 1 failed, 2 wrong command line, 3 some rows or values are bad\n"
         "(points, invert, texture, fit).\n"
         "\nExamples\n%s",
         command->examples);
}
