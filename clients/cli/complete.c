/* Lists completions of a command line for shells. */

#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/options.h"
#include "clients/cli/profile.h"

/* Prints a candidate that begins with `start`. before: text before that in the word, kept. */
static void offer(const char *before, const char *start, const char *name, const char *about) {
  if (strncmp(name, start, strlen(start)) == 0) {
    printf("%s%s%s%.*s\n", before, name, about[0] != '\0' ? "\t" : "", (int)strcspn(about, ";."),
           about);
  }
}

/* Values of options: the names of a list, or others, separated by commas. */
static const struct {
  const char *option;
  enum dipole_kind kind;
  const char *others;
} values[] = {{"model", DIPOLE_MODEL, NULL},
              {"evaluator", DIPOLE_EVALUATOR, NULL},
              {"moments", DIPOLE_MOMENTS, NULL},
              {"phase", DIPOLE_PHASE, NULL},
              {"scale", DIPOLE_SCALE, NULL},
              {"light", DIPOLE_LIGHT, NULL},
              {"coefficients", DIPOLE_COEFFICIENT, NULL},
              {"wanted", DIPOLE_QUANTITY, NULL},
              {"quantity", DIPOLE_QUANTITY, NULL},
              {"draw", DIPOLE_DRAW, NULL},
              {"channel", 0, "red,green,blue"},
              {"axes", 0, "linear,semilog,logarithmic"},
              {"connect", 0, "unix:,tcp:,tls:,private:"}};

static void offer_list(const char *before, const char *start, const char *list) {
  char *copy = cli_copy(list, strlen(list));
  for (const char *value; copy != NULL && (value = strsep(&copy, ",")) != NULL;) {
    offer(before, start, value, "");
  }
}

/* Lists values of an option. before: what precedes the value in its word. */
static void offer_values(const cli_command *command, const cli_option *option, const char *before,
                         const char *start) {
  const char *comma = strrchr(start, ',');
  const bool many = option->argument != NULL && strstr(option->argument, "...") != NULL;
  const size_t kept = many && comma != NULL ? (size_t)(comma + 1 - start) : 0;
  char *head = cli_allocate(strlen(before) + kept + 1, 1);
  dipole_info *info = NULL;
  dipole_error error;
  memcpy(head, before, strlen(before));
  memcpy(head + strlen(before), start, kept);
  start += kept;
  for (size_t i = 0; i < sizeof values / sizeof values[0]; i++) {
    const dipole_choice *choice;
    const bool is_it = strcmp(values[i].option, option->name) == 0;
    if (is_it && values[i].others != NULL) {
      offer_list(head, start, values[i].others);
    } else if (is_it && dipole_local_info(&info, &error)) {
      for (size_t from = 0; (choice = cli_next_choice(info, values[i].kind, &from)) != NULL;) {
        offer(head, start, choice->name, "");
      }
    }
  }
  if (strcmp(option->name, "format") == 0) {
    offer_list(head, start, command->formats);
  }
  for (size_t i = 0; strcmp(option->name, "medium") == 0 && i < core_measured_media_count; i++) {
    offer(head, start, core_measured_media[i].name, "");
  }
  free(info);
}

/* Lists what may replace `last`, the last word. previous: the word before it. */
static void offer_words(const cli_command *command, const char *previous, const char *last) {
  const cli_option *option;
  char name[64];
  for (option = cli_options_of(command); option->name != NULL; option++) {
    const int length = snprintf(name, sizeof name, "--%s=", option->name);
    if (option->kind != CLI_HEADING && strncmp(last, name, (size_t)length) == 0) {
      offer_values(command, option, name, last + length);
      return;
    }
    name[length - 1] = '\0';
    if (option->kind != CLI_HEADING && option->kind != CLI_SWITCH && strcmp(previous, name) == 0) {
      offer_values(command, option, "", last);
      return;
    }
  }
  const bool names = last[0] == '-' || command->operand == NULL;
  for (option = cli_options_of(command); names && option->name != NULL; option++) {
    snprintf(name, sizeof name, "--%s", option->name);
    if (option->kind != CLI_HEADING) {
      offer("", last, name, option->help != NULL ? option->help : command->formats);
    }
  }
}

int cli_complete(const char *line) {
  enum { WORDS_MAX = 256 };
  char *words[WORDS_MAX + 1] = {0}, *rest = cli_copy(line, strlen(line));
  size_t count = 0;
  for (char *word; count < WORDS_MAX && (word = strsep(&rest, " \t")) != NULL;) {
    if (word[0] != '\0' || rest == NULL) {
      words[count++] = word;
    }
  }
  const bool names = count == 2 || (count == 3 && strcmp(words[1], "help") == 0);
  for (size_t i = 0; cli_commands[i] != NULL; i++) {
    if (names) {
      offer("", words[count - 1], cli_commands[i]->name, cli_commands[i]->about);
    } else if (count > 2 && strcmp(cli_commands[i]->name, words[1]) == 0) {
      offer_words(cli_commands[i], words[count - 2], words[count - 1]);
    }
  }
  if (names) {
    offer("", words[count - 1], "help", "");
  }
  return CLI_OK;
}
