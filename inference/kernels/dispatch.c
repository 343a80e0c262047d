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

#define DECLARE(variant)                                                                   \
    int64_t scratch_bytes_##variant(const Scene *scene, int64_t max_count);                \
    int64_t march_##variant(const Scene *scene, const Rays *rays, Gathered *out);          \
    int64_t sweep_columns_##variant(const ColumnSweep *data);                              \
    int64_t sweep_blocks_##variant(const BlockSweep *data);                                \
    int64_t sample_open_depths_##variant(const OpenDepthSamples *data);                    \
    int64_t sweep_ordinates_##variant(const OrdinateSweep *data);                          \
    int64_t sweep_radiance_##variant(const RadianceSweep *data);                           \
    int64_t sweep_moments_##variant(const MomentSweep *data);                              \
    int64_t follow_peak_##variant(const PeakPhotons *data);                                \
    int64_t trace_paths_##variant(const LightPaths *data);                                 \
    int64_t conjugate_gradients_##variant(Diffusion *data);                                \
    int64_t mean_cells_##variant(const CellMeans *data);                                   \
    int64_t halve_##variant(const Halving *data);                                          \
    int64_t fill_lattice_##variant(const LatticePart *data);                               \
    int64_t resample_##variant(const Resampling *data);                                    \
    int64_t fill_lamp_columns_##variant(const LampSlices *data);                           \
    int64_t lamp_depths_##variant(const LampDepths *data);                                 \
    int64_t lamp_beam_##variant(const LampBeam *data);                                     \
    int64_t lamp_fluence_##variant(const LampFluence *data);                               \
    int64_t scatter_nearby_##variant(const NearbyLight *data);                             \
    int64_t gather_light_##variant(const LightGather *data);                               \
    int64_t multiply_##variant(const MatrixProduct *data);
DECLARE(baseline)
#if defined(__x86_64__) && !defined(MRPNN_ONE_VARIANT)
DECLARE(avx2)
DECLARE(avx512)

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

/* Bytes of scratch memory that rays of at most so many steps take. */
EXPORT int64_t mrpnn_scratch_bytes(const Scene *scene, int64_t max_count) {
    return scratch_bytes_baseline(scene, max_count);
}

/* March rays; returns how many of them, fewer than asked for if they were to stop. */
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
PREPARE(sweep_columns, const ColumnSweep)
PREPARE(sweep_blocks, const BlockSweep)
PREPARE(sample_open_depths, const OpenDepthSamples)
PREPARE(sweep_ordinates, const OrdinateSweep)
PREPARE(sweep_radiance, const RadianceSweep)
PREPARE(sweep_moments, const MomentSweep)
PREPARE(follow_peak, const PeakPhotons)
PREPARE(trace_paths, const LightPaths)
PREPARE(conjugate_gradients, Diffusion)
PREPARE(mean_cells, const CellMeans)
PREPARE(halve, const Halving)
PREPARE(fill_lattice, const LatticePart)
PREPARE(resample, const Resampling)
PREPARE(fill_lamp_columns, const LampSlices)
PREPARE(lamp_depths, const LampDepths)
PREPARE(lamp_beam, const LampBeam)
PREPARE(lamp_fluence, const LampFluence)
PREPARE(scatter_nearby, const NearbyLight)
PREPARE(gather_light, const LightGather)
PREPARE(multiply, const MatrixProduct)
