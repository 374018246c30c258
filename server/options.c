#include "server/options.h"

#include <ctype.h>
#include <errno.h>
#include <getopt.h>
#include <regex.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum kind { NUMBER, TEXT, LIST };

struct description {
  const char *name;
  const char *field_name;
  const char *value;
  const char *separators;
  const char *help;
  enum kind kind;
  size_t offset; /* offset of its member in struct options */
  uint64_t least;
  uint64_t most;
  uint64_t default_value;
};

#define AT(field) offsetof(struct options, field)
#define SERVER_NUMBER(field, name, default_value, least, most, help)                               \
  {name, #field, "N", "", help, NUMBER, AT(field), least, most, default_value},
#define SERVER_TEXT(field, name, value, help)                                                      \
  {name, #field, value, "", help, TEXT, AT(field), 0, 0, 0},
#define SERVER_LIST(field, name, value, separators, help)                                          \
  {name, #field, value, separators, help, LIST, AT(field), 0, 0, 0},
static const struct description descriptions[] = {
#include "server/options.def"
};

enum { OPTIONS = sizeof descriptions / sizeof descriptions[0], HELP = OPTIONS, VERSION };

static void *option_place(struct options *options, const struct description *option) {
  return (char *)options + option->offset;
}

/* ---- values ---------------------------------------------------------------------------------- */

static bool set_number(const struct description *option, const char *text, uint64_t *number) {
  char *end;
  errno = 0;
  const unsigned long long value = strtoull(text, &end, 10);
  if (!isdigit((unsigned char)text[0]) || *end != '\0' || errno != 0 || value < option->least ||
      value > option->most) {
    fprintf(stderr, "dipoled: --%s is a number from %llu to %llu, not '%s'\n", option->name,
            (unsigned long long)option->least, (unsigned long long)option->most, text);
    return false;
  }
  *number = value;
  return true;
}

static bool add_item(const struct description *option, const char *text,
                     struct options_list *list) {
  if (list->count == OPTIONS_LIST_MAX) {
    fprintf(stderr, "dipoled: --%s can be given %d times at most\n", option->name,
            OPTIONS_LIST_MAX);
    return false;
  }
  list->items[list->count++] = text;
  return true;
}

static bool set_option(struct options *options, const struct description *option,
                       const char *text) {
  switch (option->kind) {
  case NUMBER:
    return set_number(option, text, option_place(options, option));
  case TEXT:
    *(const char **)option_place(options, option) = text;
    return true;
  case LIST:
    return add_item(option, text, option_place(options, option));
  }
  return false;
}

/* ---- environment ----------------------------------------------------------------------------- */

enum { VARIABLE_BYTES = 64, LINE_BYTES = 2048 };
#define VARIABLE_PREFIX "DIPOLED_"

/* Writes the name of an option's environment variable: DIPOLED_ and its field in capitals. */
static void name_variable(const struct description *option, char name[VARIABLE_BYTES]) {
  snprintf(name, VARIABLE_BYTES, VARIABLE_PREFIX "%s", option->field_name);
  for (char *c = name; *c != '\0'; c++) {
    *c = (char)toupper((unsigned char)*c);
  }
}

static bool read_environment_list(struct options *options, const struct description *option,
                                  const char *text) {
  struct options_list *list = option_place(options, option);
  list->copy = strdup(text);
  if (list->copy == NULL) {
    return false;
  }
  char *rest = list->copy;
  const char *separators = option->separators;
  for (char *item = strtok_r(rest, separators, &rest); item != NULL;
       item = strtok_r(NULL, separators, &rest)) {
    if (!set_option(options, option, item)) {
      return false;
    }
  }
  return true;
}

/* Returns whether Kubernetes or Docker has set a variable for a service that is called dipoled, or
 * dipoled-NAME. */
static bool is_of_a_service(const char *variable) {
  regex_t form;
  if (regcomp(&form,
              "^" VARIABLE_PREFIX "([A-Z0-9_]+_)?(SERVICE_HOST=|SERVICE_PORT(_[A-Z0-9_]+)?=[0-9]+$|"
              "PORT=[a-z]+://|PORT_[0-9]+_(TCP|UDP|SCTP)(_(PROTO|PORT|ADDR))?=)",
              REG_EXTENDED | REG_NOSUB) != 0) {
    return false;
  }
  const bool matches = regexec(&form, variable, 0, NULL, 0) == 0;
  regfree(&form);
  return matches;
}

/* Returns whether a variable sets an option, or is DIPOLED_CA, a variable of clients. */
static bool is_of_an_option(const char *variable) {
  const size_t length = strcspn(variable, "=");
  bool is = strncmp(variable, VARIABLE_PREFIX "CA=", length + 1) == 0;
  for (int i = 0; i < OPTIONS && !is; i++) {
    char name[VARIABLE_BYTES];
    name_variable(&descriptions[i], name);
    is = strlen(name) == length && strncmp(variable, name, length) == 0;
  }
  return is;
}

/* Refuses variables that look like an option but are none, so that none is ignored in silence. */
static bool check_variables(void) {
  bool good = true;
  for (char **variable = environ; *variable != NULL; variable++) {
    if (strncmp(*variable, VARIABLE_PREFIX, strlen(VARIABLE_PREFIX)) == 0 &&
        !is_of_a_service(*variable) && !is_of_an_option(*variable)) {
      fprintf(stderr,
              "dipoled: the environment variable %.*s is no option; dipoled --help lists them\n",
              (int)strcspn(*variable, "="), *variable);
      good = false;
    }
  }
  return good;
}

/* is_private: the daemon is for one program alone, whose user may have set these variables for
 * another daemon. */
static bool read_environment(struct options *options, bool is_private) {
  for (int i = 0; i < OPTIONS; i++) {
    const struct description *option = &descriptions[i];
    const bool serves_others = option->offset == AT(listen) || option->offset == AT(modbus) ||
                               option->offset == AT(http) || option->offset == AT(metrics) ||
                               option->offset == AT(scpi);
    if (is_private && serves_others) {
      continue;
    }
    char name[VARIABLE_BYTES];
    name_variable(option, name);
    const char *text = getenv(name);
    if (text == NULL || *text == '\0') {
      continue;
    }
    const bool good = option->kind == LIST ? read_environment_list(options, option, text)
                                           : set_option(options, option, text);
    if (!good) {
      fprintf(stderr, "dipoled: the value is that of the environment variable %s\n", name);
      return false;
    }
  }
  return true;
}

/* ---- help ------------------------------------------------------------------------------------ */

static void print_wrapped(const char *text, int indent, int width) {
  int column = indent;
  while (*text != '\0') {
    const int word = (int)strcspn(text, " ");
    if (column > indent && column + 1 + word > width) {
      printf("\n%*s", indent, "");
      column = indent;
    }
    column += printf("%s%.*s", column > indent ? " " : "", word, text);
    text += word;
    text += strspn(text, " ");
  }
  printf("\n");
}

static void print_option(const struct description *option) {
  char title[48];
  snprintf(title, sizeof title, "--%s %s", option->name, option->value);
  printf("  %-25s ", title);
  print_wrapped(option->help, 28, 96);
  if (option->kind == NUMBER) {
    printf("%28s(%llu; %llu to %llu)\n", "", (unsigned long long)option->default_value,
           (unsigned long long)option->least, (unsigned long long)option->most);
  }
}

static void print_help(void) {
  printf(
      "dipoled " DIPOLED_VERSION ": evaluates subsurface-scattering profiles R(r) for clients.\n"
      "\n"
      "usage: dipoled [OPTION [VALUE]]...\n"
      "\n"
      "examples:\n"
      "  dipoled                                   this machine only, at the default addresses\n"
      "  dipoled --listen unix:/run/dipoled.sock --workers 4\n"
      "  dipoled --listen tcp:0.0.0.0:4817         every address of this machine\n"
      "  dipoled --listen tls:0.0.0.0:4818 --certificate farm.pem --key farm.key --client-ca "
      "ca.pem\n"
      "  dipoled --metrics 127.0.0.1:9817          numbers for Prometheus, /healthz, /readyz\n"
      "  dipoled --http 127.0.0.1:8017             also JSON for curl and browsers\n"
      "  dipoled --modbus tcp:127.0.0.1:5020       also registers for instruments\n"
      "\n"
      "SIGTERM, SIGINT and SIGHUP stop it: it replies to all requests that it has read, and exits\n"
      "with 0. With a tls: address, SIGHUP reads the certificates again instead. The command\n"
      "`dipole` is a client. The environment can set each option, as DIPOLED_ and its name in\n"
      "capitals with underscores (DIPOLED_MAX_MEDIA); the command line wins. Any other variable\n"
      "that starts with DIPOLED_ is an error, except those that Kubernetes sets for a Service of\n"
      "this name.\n"
      "\n"
      "options (default; range):\n");
  for (int i = 0; i < OPTIONS; i++) {
    print_option(&descriptions[i]);
  }
  printf("  %-25s this text\n  %-25s the version\n", "--help", "--version");
}

/* ---- command line ---------------------------------------------------------------------------- */

static enum options_outcome read_command_line(int argc, char **argv, struct options *options) {
  struct option longs[OPTIONS + 3] = {{0}};
  bool begun[OPTIONS] = {false};
  for (int i = 0; i < OPTIONS; i++) {
    longs[i] = (struct option){descriptions[i].name, required_argument, NULL, i};
  }
  longs[HELP] = (struct option){"help", no_argument, NULL, HELP};
  longs[VERSION] = (struct option){"version", no_argument, NULL, VERSION};
  int which;
  while ((which = getopt_long(argc, argv, "", longs, NULL)) != -1) {
    if (which == HELP) {
      print_help();
      return OPTIONS_EXIT_OK;
    }
    if (which == VERSION) {
      printf("dipoled " DIPOLED_VERSION "\n");
      return OPTIONS_EXIT_OK;
    }
    if (which < 0 || which >= OPTIONS) {
      fprintf(stderr, "dipoled --help lists the options\n");
      return OPTIONS_EXIT_USAGE;
    }
    const struct description *option = &descriptions[which];
    if (option->kind == LIST && !begun[which]) {
      ((struct options_list *)option_place(options, option))->count = 0;
    } else if (option->kind == TEXT && begun[which]) {
      fprintf(stderr, "dipoled: --%s is given twice, and takes one %s\n", option->name,
              option->value);
      return OPTIONS_EXIT_USAGE;
    }
    begun[which] = true;
    if (!set_option(options, option, optarg)) {
      return OPTIONS_EXIT_USAGE;
    }
  }
  if (optind < argc) {
    fprintf(stderr, "dipoled: '%s' is not an option; dipoled --help lists them\n", argv[optind]);
    return OPTIONS_EXIT_USAGE;
  }
  return OPTIONS_RUN;
}

enum options_outcome options_read(int argc, char **argv, struct options *options) {
  *options = (struct options){0};
  for (int i = 0; i < OPTIONS; i++) {
    if (descriptions[i].kind == NUMBER) {
      *(uint64_t *)option_place(options, &descriptions[i]) = descriptions[i].default_value;
    }
  }
  bool is_private = false;
  for (int i = 1; i < argc; i++) {
    is_private |= strncmp(argv[i], "--fd", 4) == 0;
  }
  if (!read_environment(options, is_private) || !check_variables()) {
    return OPTIONS_EXIT_USAGE;
  }
  const enum options_outcome outcome = read_command_line(argc, argv, options);
  if (options->max_part_bytes > options->max_frame_bytes) {
    /* A part is a frame: it cannot be larger. */
    options->max_part_bytes = options->max_frame_bytes;
  }
  return outcome;
}

bool options_read_lines(const char *path, const char *(*read)(void *context, char *line),
                        void *context, char *why, size_t why_bytes) {
  char line[LINE_BYTES];
  unsigned number = 0;
  const char *wrong = NULL;
  FILE *file = fopen(path, "re");
  if (file == NULL) {
    snprintf(why, why_bytes, "%s", strerror(errno));
    return false;
  }
  while (wrong == NULL && fgets(line, sizeof line, file) != NULL) {
    number++;
    wrong = strlen(line) + 1 == sizeof line ? "the line is too long" : read(context, line);
  }
  fclose(file);
  if (wrong != NULL) {
    snprintf(why, why_bytes, "line %u: %s", number, wrong);
  }
  return wrong == NULL;
}

void options_free(struct options *options) {
#define SERVER_LIST(field, name, value, separators, help) free(options->field.copy);
#include "server/options.def"
}

void options_each_number(const struct options *options,
                         void (*each)(void *context, const char *name, uint64_t value),
                         void *context) {
#define SERVER_NUMBER(field, name, default_value, least, most, help)                               \
  each(context, #field, options->field);
#include "server/options.def"
}
