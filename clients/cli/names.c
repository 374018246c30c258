#include <string.h>

#include "clients/cli/cli.h"

const dipole_choice *cli_next_choice(const dipole_info *info, enum dipole_kind kind, size_t *from) {
  while (*from < info->choice_count) {
    const dipole_choice *choice = &info->choices[(*from)++];
    if (choice->kind == kind) {
      return choice;
    }
  }
  return NULL;
}

const dipole_choice *cli_choice(const dipole_info *info, enum dipole_kind kind, const char *name) {
  const dipole_choice *choice;
  for (size_t from = 0; (choice = cli_next_choice(info, kind, &from)) != NULL;) {
    if (strcmp(choice->name, name) == 0) {
      return choice;
    }
  }
  return NULL;
}

const dipole_choice *cli_choice_of_id(const dipole_info *info, enum dipole_kind kind, unsigned id) {
  const dipole_choice *choice;
  for (size_t from = 0; (choice = cli_next_choice(info, kind, &from)) != NULL;) {
    if (choice->id == id) {
      return choice;
    }
  }
  return NULL;
}

bool cli_is_noted(unsigned notes, const dipole_choice *note) {
  return note->id != 0 && (notes & note->id) == note->id;
}

void cli_list_names(const dipole_info *info, enum dipole_kind kind, char *text, size_t bytes) {
  static const char more[] = ", ...";
  const dipole_choice *choice;
  size_t length = 0;
  text[0] = '\0';
  for (size_t from = 0; (choice = cli_next_choice(info, kind, &from)) != NULL;) {
    const size_t added = strlen(choice->name) + (length > 0 ? strlen(", ") : 0);
    if (length + added + sizeof more > bytes) {
      snprintf(text + length, bytes - length, "%s", more);
      return;
    }
    length += (size_t)snprintf(text + length, bytes - length, "%s%s", length > 0 ? ", " : "",
                               choice->name);
  }
}

const dipole_choice *cli_named(const cli_command *command, const dipole_info *info,
                               enum dipole_kind kind, const char *option, const char *name) {
  char known[1024];
  const dipole_choice *choice = cli_choice(info, kind, name);
  if (choice == NULL) {
    cli_list_names(info, kind, known, sizeof known);
    cli_fail_usage(command, "--%s: '%s' is unknown; this daemon has %s", option, name, known);
  }
  return choice;
}

const char *cli_option_of(const cli_command *command, const char *field, char *text, size_t bytes) {
  static const struct {
    const char *field, *option;
  } others[] = {{"radius_start", "from"},
                {"radius_stop", "to"},
                {"radius_count", "count"},
                {"sample_count", "count"},
                {"sample_first", "first"}};
  for (size_t i = 0; i < sizeof others / sizeof others[0]; i++) {
    if (strcmp(others[i].field, field) == 0) {
      field = others[i].option;
    }
  }
  const cli_option *option = cli_options_find(command, field);
  text[0] = '\0';
  if (option != NULL) {
    snprintf(text, bytes, " (--%s)", option->name);
  }
  return text;
}
