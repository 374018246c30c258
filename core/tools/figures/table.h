/* table: writes and reads panels as CSV files. A value that is not known is an empty field. Numbers
 * have so many digits that reading them gives the same bits. */
#ifndef FIGURES_TABLE_H
#define FIGURES_TABLE_H

#include <stdio.h>

#include "core/tools/figures/panel.h"
#include "core/tools/tools.h"

/* Writes a comma and the number, or a comma alone for NaN. */
void table_put(FILE *file, double number);

/* Writes the columns of one source of one panel, with a row for each ring. */
void table_keep(const char *path, const panel_data *panel, enum panel_source source);

/* Reads a file of table_keep(). Returns false and leaves the panel unchanged if there is no such
 * file or it holds anything else. */
bool table_recall(const char *path, panel_data *panel, enum panel_source source);

/* Writes all columns of the wanted panels of a figure, given by its number. The rows begin with
 * figure, ratio, eta and r; there is a row for each ring. table_write_albedos() writes the albedos,
 * with a row for each panel and curve. */
void table_write_figure(const char *path, size_t figure, const panel_data *const *panels,
                        size_t count);
void table_write_albedos(const char *path, size_t figure, const panel_data *const *panels,
                         size_t count);

#endif
