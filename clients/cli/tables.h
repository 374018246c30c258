/* tables: what `dipole table` fetches, a file of it, and what is written of it. */
#ifndef DIPOLE_CLI_TABLES_H
#define DIPOLE_CLI_TABLES_H

#include "clients/cli/channels.h"
#include "clients/cli/parameters.h"

typedef struct cli_tables {
  size_t count;
  dipole_table **items;
} cli_tables;

/* One more, which it takes over. */
void cli_tables_add(cli_tables *tables, dipole_table *table);
void cli_tables_free(cli_tables *tables);

typedef struct cli_tables_report {
  const dipole_info *info;
  const dipole_choice *model, *moments;
  cli_parameters parameters; /* as given */
  cli_channels channels;
  cli_tables tables; /* one for each channel */
} cli_tables_report;

/* ---- tables_file.c: these say what is wrong ------------------------------------------------ */

/* Reads a file (-: standard input) of one table or more, one behind the other. */
bool cli_tables_read(const cli_command *command, const char *path, cli_tables *tables);

/* Writes one (-: standard output); nothing to a terminal. */
bool cli_tables_save(const cli_command *command, const char *path, const cli_tables *tables);

/* ---- tables_write.c ------------------------------------------------------------------------ */

void cli_tables_write_table(const cli_tables_report *report, FILE *file);
void cli_tables_write_csv(const cli_tables_report *report, FILE *file);
void cli_tables_write_json(const cli_tables_report *report, FILE *file);

#endif
