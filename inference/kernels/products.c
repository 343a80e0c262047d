/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Layers of networks, products of matrices and sums: inference/onnx/products.py packs the right matrix. */

#include "fields.h"
#include "variants.h"

#include <string.h>

/* Columns of a panel, and the tile whose sums stay in registers: rows by panels. */
#define PANEL MRPNN_PANEL
#if defined(__AVX512F__)
#define ROWS 12
#define PANELS 2
#elif defined(__AVX2__) || defined(__aarch64__)
#define ROWS 6
#define PANELS 1
#else
#define ROWS 3
#define PANELS 1
#endif
/* Rows that pass all panels before the next rows, so that they stay in the cache. */
#define BLOCK (8 * ROWS)

typedef float Panel __attribute__((vector_size(4 * PANEL)));
typedef int32_t PanelBits __attribute__((vector_size(4 * PANEL)));

#if defined(__FMA__) || defined(__aarch64__)
#define ADD_PRODUCT(a, b, sum) __builtin_elementwise_fma(a, b, sum)
#else
#define ADD_PRODUCT(a, b, sum) ((a) * (b) + (sum))
#endif

/* Compilers use registers as wide as what functions return. */
static inline Panel load_panel(const float *from) {
    Panel values;
    memcpy(&values, from, sizeof values);
    return values;
}

static inline int64_t less_of(int64_t a, int64_t b) { return a < b ? a : b; }

/* Add to a panel of sums, and store the first of them. */
static inline __attribute__((always_inline)) void finish(const MatrixProduct *data, Panel sum, const float *added,
                                                         int64_t width, float *out) {
    if (added) {
        Panel values = {0.0f};
        memcpy(&values, added, (size_t)width * sizeof(float));
        sum += values;
    }
    if (data->rectified) sum = (Panel)((PanelBits)sum & ~(PanelBits)(sum < 0.0f));
    memcpy(out, &sum, (size_t)width * sizeof(float));
}

/* One tile from its row and panel on; `rows` and `panels` are constants wherever it is called. */
static inline __attribute__((always_inline)) void tile(const MatrixProduct *data, int64_t row, int64_t panel, int rows,
                                                       int panels) {
    int64_t inner = data->inner, columns = data->columns;
    const float *left = data->left + row * inner, *right = data->right + panel * inner * PANEL;
    Panel sums[ROWS][PANELS];
    for (int r = 0; r < rows; r++)
        for (int p = 0; p < panels; p++) sums[r][p] = (Panel){0.0f};
    for (int64_t k = 0; k < inner; k++) {
        Panel values[PANELS];
        for (int p = 0; p < panels; p++) values[p] = load_panel(right + (p * inner + k) * PANEL);
        for (int r = 0; r < rows; r++) {
            Panel factor = left[r * inner + k] - (Panel){0.0f};
            for (int p = 0; p < panels; p++) sums[r][p] = ADD_PRODUCT(factor, values[p], sums[r][p]);
        }
    }
    for (int p = 0; p < panels; p++) {
        int64_t first = (panel + p) * PANEL, width = less_of(columns - first, PANEL);
        Panel bias = load_panel(data->bias + first);
        for (int r = 0; r < rows; r++) {
            const float *added = data->added ? data->added + (row + r) * columns + first : NULL;
            float *out = data->out + (row + r) * columns + first;
            /* Whole panels in one move each. */
            if (width == PANEL) finish(data, sums[r][p] + bias, added, PANEL, out);
            else finish(data, sums[r][p] + bias, added, width, out);
        }
    }
}

int64_t NAMED(multiply, VARIANT)(const MatrixProduct *data) {
    int64_t panels = (data->columns + PANEL - 1) / PANEL;
    for (int64_t first = 0; first < data->rows; first += BLOCK) {
        int64_t end = less_of(first + BLOCK, data->rows);
        for (int64_t panel = 0; panel < panels; panel += PANELS) {
            int whole = panel + PANELS <= panels;
            int64_t row = first;
            for (; row + ROWS <= end; row += ROWS) {
                if (whole) tile(data, row, panel, ROWS, PANELS);
                else tile(data, row, panel, ROWS, 1);
            }
            for (; row < end; row++) {
                if (whole) tile(data, row, panel, 1, PANELS);
                else tile(data, row, panel, 1, 1);
            }
        }
    }
    return 0;
}
