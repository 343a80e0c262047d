/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Names of functions that are compiled once for each kind of processor, with the name of the kind as VARIANT. */

#ifndef MRPNN_VARIANTS_H
#define MRPNN_VARIANTS_H

#define JOINED(a, b) a##_##b
#define NAMED(a, b) JOINED(a, b)

#endif
