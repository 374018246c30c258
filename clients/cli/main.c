/* dipole: the command line of dipoled. Each command is a file of its own. */
#include <errno.h>
#include <stdarg.h>
#include <string.h>

#include "clients/cli/cli.h"

const cli_command *const cli_commands[] = {
    &cli_command_eval,   &cli_command_plot,  &cli_command_points, &cli_command_sample,
    &cli_command_invert, &cli_command_table, &cli_command_mc,     &cli_command_media,
    &cli_command_info,   &cli_command_top,   &cli_command_bench,  NULL,
};

static void say(const cli_command *command, const char *format, va_list arguments) {
  fprintf(stderr, "dipole %s: ", command->name);
  vfprintf(stderr, format, arguments);
  fputc('\n', stderr);
}

int cli_fail(const cli_command *command, const char *format, ...) {
  va_list arguments;
  va_start(arguments, format);
  say(command, format, arguments);
  va_end(arguments);
  return CLI_FAILED;
}

int cli_fail_usage(const cli_command *command, const char *format, ...) {
  va_list arguments;
  va_start(arguments, format);
  say(command, format, arguments);
  va_end(arguments);
  fprintf(stderr, "`dipole %s --help` tells more.\n", command->name);
  return CLI_USAGE;
}

static void print_help(FILE *file) {
  fputs("Usage: dipole COMMAND [OPTION]...\n\n"
        "Asks a dipoled how much light leaves a translucent medium at distance r from where it\n"
        "entered: R(r) in 1/mm^2 per unit of power that entered. Without --connect and $DIPOLED\n"
        "it starts a daemon of its own.\n\nCommands\n",
        file);
  for (const cli_command *const *command = cli_commands; *command != NULL; command++) {
    fprintf(file, "  %-8s %s\n", (*command)->name, (*command)->about);
  }
  fputs("  help     This text, or `dipole help COMMAND`\n\n"
        "`dipole COMMAND --help` tells about a command; `dipole --version` the version.\n",
        file);
}

static const cli_command *find_command(const char *name) {
  for (const cli_command *const *command = cli_commands; *command != NULL; command++) {
    if (strcmp((*command)->name, name) == 0) {
      return *command;
    }
  }
  return NULL;
}

static int fail_unknown(const char *name) {
  fprintf(stderr, "dipole: there is no command '%s'; the commands are", name);
  for (const cli_command *const *command = cli_commands; *command != NULL; command++) {
    fprintf(stderr, " %s,", (*command)->name);
  }
  fputs(" help\n", stderr);
  return CLI_USAGE;
}

static int help(const char *name) {
  const cli_command *command = name != NULL ? find_command(name) : NULL;
  if (name != NULL && command == NULL) {
    return fail_unknown(name);
  }
  if (command != NULL) {
    cli_options_help(command);
  } else {
    print_help(stdout);
  }
  return CLI_OK;
}

static int run(int argc, char **argv) {
  if (argc < 2) {
    print_help(stderr);
    return CLI_USAGE;
  }
  if (strcmp(argv[1], "--version") == 0) {
    puts("dipole " DIPOLED_VERSION);
    return CLI_OK;
  }
  if (strcmp(argv[1], "help") == 0 || strcmp(argv[1], "--help") == 0) {
    return help(argc > 2 ? argv[2] : NULL);
  }
  const cli_command *command = find_command(argv[1]);
  return command != NULL ? command->run(command, argc - 1, argv + 1) : fail_unknown(argv[1]);
}

int main(int argc, char **argv) {
  int status = run(argc, argv);
  errno = 0;
  if (fflush(stdout) != 0 || ferror(stdout)) {
    fprintf(stderr, "dipole: cannot write the output: %s\n",
            errno != 0 ? strerror(errno) : "it failed");
    status = CLI_FAILED;
  }
  return status;
}
