/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Runs networks in onnxruntime.dll without Python, and loads the module that Python would import.

onnxruntime_check LIBRARY...            loads each library
onnxruntime_check --run FILE...         FILE.onnx is run on FILE.in, the result goes to FILE.out

FILE.in: the output's name, the number of inputs, and of each its name, its type (1: float, 6: int32, as in ONNX), its
rank, its shape and its values; names are 32 bytes, numbers int64. FILE.out: float32. Exit status 0 where all succeed.
*/

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <windows.h>

#define API 17
#define MOST 16
/* Places in the structure OrtApi, which never change. */
enum {
    MESSAGE = 2,
    ENVIRONMENT = 3,
    SESSION = 7,
    RUN = 9,
    OPTIONS = 10,
    THREADS = 24,
    TENSOR = 49,
    VALUES = 51,
    COUNT = 64,
    SHAPE = 65,
    MEMORY = 69
};

static void **api;

static void fail(const char *what, const char *why) {
    printf("%s: %s\n", what, why);
    exit(1);
}

static void check(const char *what, void *status) {
    if (status) fail(what, ((const char *(*)(void *))api[MESSAGE])(status));
}

static HMODULE load(const char *name) {
    HMODULE library = LoadLibraryA(name);
    if (library) return library;
    printf("%s does not load: error %lu\n", name, GetLastError());
    exit(2);
}

static void read(void *target, size_t size, FILE *file) {
    if (fread(target, 1, size, file) != size) fail("input", "too short");
}

static int64_t number(FILE *file) {
    int64_t value;
    read(&value, sizeof value, file);
    return value;
}

static FILE *beside(const char *name, const char *suffix, const char *mode) {
    char path[MAX_PATH];
    snprintf(path, sizeof path, "%s%s", name, suffix);
    FILE *file = fopen(path, mode);
    if (!file) fail(path, "cannot be opened");
    return file;
}

static void run(void *environment, const char *name) {
    char path[MAX_PATH], output[32], names[MOST][32];
    const char *inputs[MOST], *outputs[1] = {output};
    WCHAR wide[MAX_PATH];
    void *options, *session, *memory, *tensors[MOST], *result = NULL, *shape;
    snprintf(path, sizeof path, "%s.onnx", name);
    MultiByteToWideChar(CP_ACP, 0, path, -1, wide, MAX_PATH);
    check("options", ((void *(*)(void **))api[OPTIONS])(&options));
    check("threads", ((void *(*)(void *, int))api[THREADS])(options, 1));
    check(path, ((void *(*)(void *, const WCHAR *, void *, void **))api[SESSION])(environment, wide, options, &session));
    check("memory", ((void *(*)(int, int, void **))api[MEMORY])(0, 0, &memory));

    FILE *in = beside(name, ".in", "rb");
    read(output, sizeof output, in);
    int64_t count = number(in);
    if (count > MOST) fail(name, "too many inputs");
    for (int64_t n = 0; n < count; n++) {
        read(names[n], sizeof names[n], in);
        inputs[n] = names[n];
        int64_t type = number(in), rank = number(in), sizes[8];
        size_t bytes = 4;
        if (rank > 8) fail(name, "too many axes");
        for (int64_t axis = 0; axis < rank; axis++) bytes *= (size_t)(sizes[axis] = number(in));
        void *values = malloc(bytes);
        read(values, bytes, in);
        check(names[n], ((void *(*)(void *, void *, size_t, const int64_t *, size_t, int, void **))api[TENSOR])(
                            memory, values, bytes, sizes, (size_t)rank, (int)type, &tensors[n]));
    }
    fclose(in);

    check("run", ((void *(*)(void *, void *, const char **, void **, size_t, const char **, size_t, void **))api[RUN])(
                     session, NULL, inputs, tensors, (size_t)count, outputs, 1, &result));
    size_t found;
    float *values;
    check("shape", ((void *(*)(void *, void **))api[SHAPE])(result, &shape));
    check("count", ((void *(*)(void *, size_t *))api[COUNT])(shape, &found));
    check("values", ((void *(*)(void *, float **))api[VALUES])(result, &values));
    FILE *out = beside(name, ".out", "wb");
    fwrite(values, sizeof *values, found, out);
    fclose(out);
}

int main(int count, char **arguments) {
    char path[MAX_PATH];
    GetModuleFileNameA(load("msvcp140.dll"), path, sizeof path);
    printf("runtime %s\n", path);
    fflush(stdout);
    if (count < 2 || strcmp(arguments[1], "--run")) {
        for (int n = 1; n < count; n++) load(arguments[n]);
        return 0;
    }
    void *base = (void *)GetProcAddress(load("onnxruntime.dll"), "OrtGetApiBase"), *environment;
    if (!base) fail("onnxruntime.dll", "has no OrtGetApiBase");
    api = (*(void **(**)(uint32_t))((void *(*)(void))base)())(API);
    if (!api) fail("onnxruntime.dll", "has another interface");
    check("environment", ((void *(*)(int, const char *, void **))api[ENVIRONMENT])(3, "check", &environment));
    for (int n = 2; n < count; n++) run(environment, arguments[n]);
    return 0;
}
