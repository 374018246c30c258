/* tables_file: a file of tables, one behind the other, as `dipole table` writes it. */
#ifndef DIPOLE_CLI_TABLES_FILE_H
#define DIPOLE_CLI_TABLES_FILE_H

#include "clients/cli/cli.h"

typedef struct cli_tables {
  size_t count;
  dipole_table **items;
} cli_tables;

/* Adds a table, which is freed with the list. */
void cli_tables_add(cli_tables *tables, dipole_table *table);
void cli_tables_free(cli_tables *tables);

/* Reads a file of one table or more; - is standard input. Says what is wrong and returns false. */
bool cli_tables_read(const char *path, cli_tables *tables);

/* Writes one; - is standard output. Refuses to write to a terminal. Says what is wrong and returns
 * false. */
bool cli_tables_save(const char *path, const cli_tables *tables);

#endif
