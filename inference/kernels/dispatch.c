/* SPDX-License-Identifier: GPL-3.0-or-later */
/* The library's functions, each in the variant that the processor can run.

MRPNN_ONE_VARIANT: built with the baseline alone, for compilers that check what the code does. */

#include "fields.h"
#include "kernels.h"

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

#define DECLARE(variant)                                                   \
    int64_t scratch_bytes_##variant(const Scene *scene, Rays *rays); \
    int64_t march_##variant(const Scene *scene, const Rays *rays, Gathered *out);
#define DECLARE_BASELINE(function, Data) int64_t function##_baseline(Data *data);
#define DECLARE_AVX2(function, Data) int64_t function##_avx2(Data *data);
#define DECLARE_AVX512(function, Data) int64_t function##_avx512(Data *data);
DECLARE(baseline)
MRPNN_FUNCTIONS(DECLARE_BASELINE)
#if defined(__x86_64__) && !defined(MRPNN_ONE_VARIANT)
DECLARE(avx2)
DECLARE(avx512)
MRPNN_FUNCTIONS(DECLARE_AVX2)
MRPNN_FUNCTIONS(DECLARE_AVX512)

#include <cpuid.h>

/* Registers that the operating system saves when it switches threads. */
static uint64_t saved_registers(void) {
    uint32_t low, high;
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return ((uint64_t)high << 32) | low;
}

static int64_t best_variant(void) {
    unsigned a, b, c, d;
    const unsigned xsave_avx_fma_f16c = 1u << 27 | 1u << 28 | 1u << 12 | 1u << 29;
    if (!__get_cpuid(1, &a, &b, &c, &d) || (c & xsave_avx_fma_f16c) != xsave_avx_fma_f16c) return 0;
    uint64_t saved = saved_registers();
    if ((saved & 0x6) != 0x6 || !__get_cpuid_count(7, 0, &a, &b, &c, &d)) return 0;
    unsigned features = b;
    const unsigned avx2_bmi1_bmi2 = 1u << 5 | 1u << 3 | 1u << 8, avx512_f_dq_cd_bw_vl = 1u << 16 | 1u << 17 | 1u << 28 | 1u << 30 | 1u << 31;
    if ((features & avx2_bmi1_bmi2) != avx2_bmi1_bmi2) return 0;
    /* lzcnt, which x86-64-v3 compilers use as well. */
    if (!__get_cpuid(0x80000001, &a, &b, &c, &d) || !(c & 1u << 5)) return 0;
    return (features & avx512_f_dq_cd_bw_vl) == avx512_f_dq_cd_bw_vl && (saved & 0xe6) == 0xe6 ? 2 : 1;
}
#else
static int64_t best_variant(void) { return 0; }
#endif

/* Number of the interface that the library was built with. */
EXPORT int64_t mrpnn_interface(void) { return MRPNN_INTERFACE; }

/* The fastest variant that this processor can run: 0 baseline, 1 AVX2, 2 AVX-512. */
EXPORT int64_t mrpnn_best_variant(void) { return best_variant(); }

#if defined(__x86_64__) && !defined(MRPNN_ONE_VARIANT)
#define CHOOSE(variant, function, ...)                       \
    (variant) == 2   ? function##_avx512(__VA_ARGS__)        \
    : (variant) == 1 ? function##_avx2(__VA_ARGS__)          \
                     : function##_baseline(__VA_ARGS__)
#else
#define CHOOSE(variant, function, ...) ((void)(variant), function##_baseline(__VA_ARGS__))
#endif

/* Numbers below the normal ones, on which x86 processors are a hundred times slower, count as 0 in these functions. The
caller's mode is returned, and restored at the end. */
#if defined(__x86_64__)
static unsigned without_subnormals(void) {
    unsigned mode = __builtin_ia32_stmxcsr();
    __builtin_ia32_ldmxcsr(mode | 0x8040u);
    return mode;
}

static int64_t restored(unsigned mode, int64_t result) {
    __builtin_ia32_ldmxcsr(mode);
    return result;
}
#else
static unsigned without_subnormals(void) { return 0; }

static int64_t restored(unsigned mode, int64_t result) { return (void)mode, result; }
#endif

/* Bytes of scratch memory that rays take; sets their `most_met`. */
EXPORT int64_t mrpnn_scratch_bytes(const Scene *scene, Rays *rays) {
    return scratch_bytes_baseline(scene, rays);
}

/* March rays; returns how many were marched, fewer than given if `stop` was set. */
EXPORT int64_t mrpnn_march(int64_t variant, const Scene *scene, const Rays *rays, Gathered *out) {
    unsigned mode = without_subnormals();
    return restored(mode, CHOOSE(variant, march, scene, rays, out));
}

/* What prepares the fields that rays and networks read; see the functions' own files. */
#define PREPARE(function, Data)                                         \
    EXPORT int64_t mrpnn_##function(int64_t variant, Data *data) {      \
        unsigned mode = without_subnormals();                           \
        return restored(mode, CHOOSE(variant, function, data));         \
    }
MRPNN_FUNCTIONS(PREPARE)
