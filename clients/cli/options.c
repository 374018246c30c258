#include "clients/cli/options.h"

#include <getopt.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/cli.h"
#include "clients/cli/number.h"

#define AT(settings, option, type) ((type *)((char *)(settings) + (option)->offset))

static const cli_option common_options[] = {
    {"Options of all commands", NULL, NULL, CLI_HEADING, 0},
    {"connect", "ADDRESS",
     "unix:PATH or tcp:HOST:PORT; several, separated by commas, are tried in turn;\n"
     "or private: for a daemon of its own (default: $DIPOLED, else private:)",
     CLI_TEXT, offsetof(cli_common, connect)},
    {"format", NULL, NULL, CLI_TEXT, offsetof(cli_common, format)},
    {"timeout-ms", "N", "give up when the daemon is silent for so long; 0: never (default: 30000)",
     CLI_COUNT, offsetof(cli_common, timeout_ms)},
    {"retry-ms", "N",
     "go on for so long while no daemon is there, one is lost or busy; 0: do not\n"
     "(default: 5000 when it is lost, --timeout-ms when it is busy)",
     CLI_COUNT, offsetof(cli_common, retry_ms)},
    {"help", NULL, "this text", CLI_SWITCH, 0},
    {0},
};

enum { TABLES = 3 };

static void get_tables(const cli_command *command, const cli_option *tables[TABLES]) {
  static const cli_option none[] = {{0}};
  tables[0] = command->options;
  tables[1] = command->shared_options != NULL ? command->shared_options : none;
  tables[2] = common_options;
}

/* `field` of a request is `option` of a command line. */
static bool is_same_name(const char *option, const char *field) {
  while (*option != '\0' && *option == (*field == '_' ? '-' : *field)) {
    option++;
    field++;
  }
  return *option == *field;
}

const cli_option *cli_options_find(const cli_command *command, const char *field) {
  const cli_option *tables[TABLES];
  get_tables(command, tables);
  for (size_t t = 0; t < TABLES; t++) {
    for (const cli_option *option = tables[t]; option->name != NULL; option++) {
      if (option->kind != CLI_HEADING && is_same_name(option->name, field)) {
        return option;
      }
    }
  }
  return NULL;
}

static bool is_format(const cli_option *option) {
  return strcmp(option->name, "format") == 0;
}
static bool is_help(const cli_option *option) {
  return strcmp(option->name, "help") == 0;
}

/* ---- values -------------------------------------------------------------------------------- */

static char *copy_text(const char *text, size_t length) {
  char *copy = cli_allocate(length + 1, 1);
  memcpy(copy, text, length);
  return copy;
}

static void add_text(cli_texts *texts, const char *text, size_t length) {
  texts->items = cli_resize(texts->items, texts->count + 1, sizeof *texts->items);
  texts->items[texts->count++] = copy_text(text, length);
}

static void free_texts(cli_texts *texts) {
  for (size_t i = 0; i < texts->count; i++) {
    free(texts->items[i]);
  }
  free(texts->items);
  *texts = (cli_texts){0};
}

/* "a,b" is two texts, "" is one that is empty. */
static void split(const char *text, cli_texts *parts) {
  free_texts(parts);
  for (const char *comma; (comma = strchr(text, ',')) != NULL; text = comma + 1) {
    add_text(parts, text, (size_t)(comma - text));
  }
  add_text(parts, text, strlen(text));
}

static bool read_numbers(const char *text, cli_numbers *numbers) {
  cli_texts parts = {0};
  bool good = true;
  split(text, &parts);
  numbers->items = cli_resize(numbers->items, parts.count, sizeof *numbers->items);
  numbers->count = parts.count;
  for (size_t i = 0; i < parts.count; i++) {
    good = cli_number_parse(parts.items[i], &numbers->items[i]) && good;
  }
  free_texts(&parts);
  return good;
}

/* What is wrong with the value; NULL: nothing. */
static const char *take_value(const cli_option *option, const char *text, void *settings) {
  switch (option->kind) {
  case CLI_SWITCH:
    *AT(settings, option, bool) = true;
    return NULL;
  case CLI_TEXT:
    *AT(settings, option, const char *) = text;
    return NULL;
  case CLI_COUNT:
    AT(settings, option, cli_count)->given = true;
    return cli_count_parse(text, &AT(settings, option, cli_count)->value) ? NULL : "whole number";
  case CLI_NUMBER:
    AT(settings, option, cli_number)->given = true;
    return cli_number_parse(text, &AT(settings, option, cli_number)->value) ? NULL : "number";
  case CLI_NUMBERS:
    return read_numbers(text, AT(settings, option, cli_numbers))
               ? NULL
               : "number (or several, separated by commas)";
  case CLI_NAMES:
    split(text, AT(settings, option, cli_texts));
    return NULL;
  case CLI_TEXTS:
  case CLI_FILES:
    add_text(AT(settings, option, cli_texts), text, strlen(text));
    return NULL;
  case CLI_HEADING:
    break;
  }
  return NULL;
}

void cli_options_free(const cli_command *command, void *settings) {
  for (const cli_option *option = command->options; option->name != NULL; option++) {
    if (option->kind == CLI_NUMBERS) {
      free(AT(settings, option, cli_numbers)->items);
    } else if (option->kind == CLI_NAMES || option->kind == CLI_TEXTS ||
               option->kind == CLI_FILES) {
      free_texts(AT(settings, option, cli_texts));
    }
  }
}

/* ---- the command line ---------------------------------------------------------------------- */

/* What getopt returns for entry i of the list: more than any character. */
enum { FIRST_RESULT = 256 };

/* The tables in getopt's form. found[i] is the entry that list[i] was made from. */
static void make_list(const cli_command *command, struct option *list, const cli_option **found) {
  const cli_option *tables[TABLES];
  size_t count = 0;
  get_tables(command, tables);
  for (size_t t = 0; t < TABLES; t++) {
    for (const cli_option *option = tables[t]; option->name != NULL; option++) {
      if (option->kind != CLI_HEADING) {
        const bool bare = option->kind == CLI_SWITCH;
        found[count] = option;
        list[count] = (struct option){.name = option->name,
                                      .has_arg = bare ? no_argument : required_argument,
                                      .val = FIRST_RESULT + (int)count};
        count++;
      }
    }
  }
  list[count] = (struct option){0};
}

static bool in_list(const char *list, const char *name) {
  const size_t length = strlen(name);
  for (const char *at = list; length > 0 && (at = strstr(at, name)) != NULL; at++) {
    if ((at == list || at[-1] == ',') && (at[length] == ',' || at[length] == '\0')) {
      return true;
    }
  }
  return false;
}

/* The operand, the format, and the bounds that getopt does not know of. */
static bool finish(const cli_command *command, int argc, char **argv, cli_common *common,
                   const char **operand, int *status) {
  *operand = optind < argc ? argv[optind] : NULL;
  if (argc - optind > (command->operand != NULL ? 1 : 0)) {
    *status = cli_fail_usage(command, "'%s' is more than it takes",
                             argv[optind + (command->operand != NULL ? 1 : 0)]);
    return false;
  }
  if (common->format != NULL && !in_list(command->formats, common->format)) {
    *status =
        cli_fail_usage(command, "--format %s: it is one of %s", common->format, command->formats);
    return false;
  }
  if (!common->timeout_ms.given) {
    common->timeout_ms.value = DIPOLE_TIMEOUT_MS;
  }
  if (common->timeout_ms.value > UINT32_MAX || common->retry_ms.value > UINT32_MAX) {
    *status = cli_fail_usage(command, "--%s: at most %lu",
                             common->timeout_ms.value > UINT32_MAX ? "timeout-ms" : "retry-ms",
                             (unsigned long)UINT32_MAX);
    return false;
  }
  return true;
}

/* The value of an option whose value may be left out: it is, when another option follows (which
 * getopt has then taken for the value) or nothing does. */
static const char *value_or_usual(const cli_command *command, const cli_option *option,
                                  char **argv) {
  if (option->kind == CLI_FILES && optarg != NULL && strncmp(optarg, "--", 2) == 0 &&
      optarg == argv[optind - 1]) {
    optind--;
    return command->usual_file;
  }
  return option->kind == CLI_FILES && optarg == NULL ? command->usual_file : optarg;
}

/* False: the command is over. */
static bool take_option(const cli_command *command, const cli_option *option, const char *value,
                        void *settings, int *status) {
  if (is_help(option)) {
    cli_options_help(command);
    *status = CLI_OK;
    return false;
  }
  const char *expected = take_value(option, value, settings);
  if (expected != NULL) {
    *status = cli_fail_usage(command, "--%s: '%s' is no %s", option->name, value, expected);
  }
  return expected == NULL;
}

enum { OPTIONS_MAX = 64 };

bool cli_options_read(const cli_command *command, int argc, char **argv, void *settings,
                      const char **operand, int *status) {
  struct option list[OPTIONS_MAX];
  const cli_option *found[OPTIONS_MAX];
  make_list(command, list, found);
  opterr = 0;
  for (;;) {
    int result = getopt_long(argc, argv, ":", list, NULL);
    if (result == -1) {
      return finish(command, argc, argv, settings, operand, status);
    }
    if (result == ':' && optopt >= FIRST_RESULT &&
        found[optopt - FIRST_RESULT]->kind == CLI_FILES) {
      result = optopt;
      optarg = NULL;
    }
    if (result == '?' && optopt != 0 && optopt < FIRST_RESULT) {
      *status = cli_fail_usage(command, "-%c: no such option", optopt);
      return false;
    }
    if (result < FIRST_RESULT) {
      *status = cli_fail_usage(command, "%s: %s", argv[optind - 1],
                               result == ':' ? "a value is missing" : "no such option");
      return false;
    }
    const cli_option *option = found[result - FIRST_RESULT];
    if (!take_option(command, option, value_or_usual(command, option, argv), settings, status)) {
      return false;
    }
  }
}

/* ---- help ---------------------------------------------------------------------------------- */

enum { HELP_COLUMN = 24 };

/* An option and its explanation, each line of which starts in the same column. */
static void print_option(const cli_option *option, const char *help) {
  const char *value = is_format(option) ? "FORMAT" : option->argument;
  int column =
      printf("  --%s%s%s", option->name, value != NULL ? " " : "", value != NULL ? value : "");
  if (column > HELP_COLUMN - 2) {
    putchar('\n');
    column = 0;
  }
  for (const char *end; *help != '\0'; help = *end == '\0' ? end : end + 1) {
    end = strchrnul(help, '\n');
    printf("%*s%.*s\n", HELP_COLUMN - column, "", (int)(end - help), help);
    column = 0;
  }
}

static void print_table(const cli_command *command, const cli_option *table) {
  for (const cli_option *option = table; option->name != NULL; option++) {
    if (option->kind == CLI_HEADING) {
      printf("\n%s\n", option->name);
    } else if (is_format(option)) {
      char help[96];
      snprintf(help, sizeof help, "one of %s (default: %.*s)", command->formats,
               (int)strcspn(command->formats, ","), command->formats);
      print_option(option, help);
    } else {
      print_option(option, option->help);
    }
  }
}

void cli_options_help(const cli_command *command) {
  const cli_option *tables[TABLES];
  get_tables(command, tables);
  printf("Usage: dipole %s [OPTION]...%s%s\n\n%s.\n", command->name,
         command->operand != NULL ? " " : "", command->operand != NULL ? command->operand : "",
         command->about);
  if (command->more != NULL) {
    printf("%s", command->more);
  }
  for (size_t t = 0; t < TABLES; t++) {
    print_table(command, tables[t]);
  }
  printf("\nExit status: 0 done, 1 failed, 2 wrong command line, 3 some rows are bad (points, "
         "invert).\n"
         "\nExamples\n%s",
         command->examples);
}
