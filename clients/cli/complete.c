#include "clients/cli/complete.h"

#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/options.h"
#include "clients/cli/profile.h"

/* Writes a candidate if it begins with what is there: `before`, which is kept, and `start`. */
static void offer(const char *before, const char *start, const char *name, const char *about) {
  if (strncmp(name, start, strlen(start)) == 0) {
    printf("%s%s%s%.*s\n", before, name, about[0] != '\0' ? "\t" : "", (int)strcspn(about, ";."),
           about);
  }
}

/* The options whose values are names of a list. */
static const struct {
  const char *option;
  enum dipole_kind kind;
} named[] = {{"model", DIPOLE_MODEL},
             {"fit-model", DIPOLE_MODEL},
             {"evaluator", DIPOLE_EVALUATOR},
             {"moments", DIPOLE_MOMENTS},
             {"phase", DIPOLE_PHASE},
             {"scale", DIPOLE_SCALE},
             {"light", DIPOLE_LIGHT},
             {"coefficients", DIPOLE_COEFFICIENT},
             {"wanted", DIPOLE_QUANTITY},
             {"quantity", DIPOLE_QUANTITY},
             {"draw", DIPOLE_DRAW}};

/* Other values, separated by commas. */
static const struct {
  const char *option, *values;
} others[] = {{"channel", "red,green,blue"},
              {"axes", "linear,semilog,logarithmic"},
              {"connect", "unix:,tcp:,tls:,private:"}};

static void offer_list(const char *before, const char *start, const char *values) {
  char *copy = strdup(values), *rest = copy;
  for (const char *value; rest != NULL && (value = strsep(&rest, ",")) != NULL;) {
    offer(before, start, value, "");
  }
  free(copy);
}

static void offer_kind(const char *before, const char *start, enum dipole_kind kind) {
  dipole_info *info;
  dipole_error error;
  const dipole_choice *choice;
  if (dipole_local_info(&info, &error)) {
    for (size_t from = 0; (choice = cli_next_choice(info, kind, &from)) != NULL;) {
      offer(before, start, choice->name, "");
    }
    free(info);
  }
}

/* Offers values of an option. before: what stands before the value on its word */
static void offer_values(const cli_command *command, const cli_option *option, const char *before,
                         const char *start) {
  char *head = NULL;
  const char *comma = strrchr(start, ',');
  const bool many = option->argument != NULL && strstr(option->argument, "...") != NULL;
  const int kept = many && comma != NULL ? (int)(comma + 1 - start) : 0;
  if (asprintf(&head, "%s%.*s", before, kept, start) < 0) {
    return;
  }
  start += kept;
  for (size_t i = 0; i < sizeof named / sizeof named[0]; i++) {
    if (strcmp(named[i].option, option->name) == 0) {
      offer_kind(head, start, named[i].kind);
    }
  }
  for (size_t i = 0; i < sizeof others / sizeof others[0]; i++) {
    if (strcmp(others[i].option, option->name) == 0) {
      offer_list(head, start, others[i].values);
    }
  }
  if (strcmp(option->name, "format") == 0) {
    offer_list(head, start, command->formats);
  }
  for (size_t i = 0; strcmp(option->name, "medium") == 0 && i < core_measured_media_count; i++) {
    offer(head, start, core_measured_media[i].name, "");
  }
  free(head);
}

static void offer_commands(const char *start) {
  for (size_t i = 0; cli_commands[i] != NULL; i++) {
    offer("", start, cli_commands[i]->name, cli_commands[i]->about);
  }
  offer("", start, "help", "");
}

/* Offers what may stand in the place of `last` behind `previous`, the word before it. */
static void offer_words(const cli_command *command, const char *previous, const char *last) {
  const char *equals = strncmp(last, "--", 2) == 0 ? strchr(last, '=') : NULL;
  const cli_option *option;
  for (option = cli_options_of(command); option->name != NULL; option++) {
    const size_t length = strlen(option->name);
    if (equals != NULL && equals == last + 2 + length &&
        strncmp(last + 2, option->name, length) == 0) {
      char before[64];
      snprintf(before, sizeof before, "--%s=", option->name);
      offer_values(command, option, before, equals + 1);
      return;
    }
    if (option->kind != CLI_SWITCH && strncmp(previous, "--", 2) == 0 &&
        strcmp(previous + 2, option->name) == 0) {
      offer_values(command, option, "", last);
      return;
    }
  }
  const bool names = last[0] == '-' || command->operand == NULL;
  for (option = cli_options_of(command); names && option->name != NULL; option++) {
    if (option->kind != CLI_HEADING) {
      char name[64];
      snprintf(name, sizeof name, "--%s", option->name);
      offer("", last, name, option->help != NULL ? option->help : command->formats);
    }
  }
}

int cli_complete(const char *line) {
  enum { WORDS_MAX = 256 };
  char *words[WORDS_MAX + 1] = {0}, *copy = strdup(line), *rest = copy;
  size_t count = 0;
  for (char *word; copy != NULL && count < WORDS_MAX && (word = strsep(&rest, " \t")) != NULL;) {
    if (word[0] != '\0' || rest == NULL) {
      words[count++] = word;
    }
  }
  if (count == 2 || (count == 3 && strcmp(words[1], "help") == 0)) {
    offer_commands(words[count - 1]);
  }
  for (size_t i = 0; count > 2 && cli_commands[i] != NULL; i++) {
    if (strcmp(cli_commands[i]->name, words[1]) == 0) {
      offer_words(cli_commands[i], words[count - 2], words[count - 1]);
    }
  }
  free(copy);
  return CLI_OK;
}
