/* The extension module of the kernels: arrays of NumPy in, numbers out.
 *
 * build_kernels.py writes the translated kernels to kernels.c, with a table of those that Python calls.
 * Everything here is of the limited API of Python 3.11, and of NumPy's, as that of 2 runs with 1.26.
 * Arrays are read by NumPy's API since Python's buffers take 0.1 to 0.3 µs an array.
 */
#define PY_SSIZE_T_CLEAN
#define NPY_NO_DEPRECATED_API NPY_1_22_API_VERSION
#include <Python.h>
#include <numpy/arrayobject.h>

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* rows is also how many entries a vector has */
typedef struct { double *at; int64_t rows; } Vector;
typedef struct { double *at; int64_t rows, width; } Matrix;
typedef struct { int64_t *at; int64_t rows; } IntVector;
typedef struct { int64_t *at; int64_t rows, width; } IntMatrix;
typedef struct { double first, second; } FloatPair;

/* At -O2 gcc leaves loops of unknown length as they are. For the short ones of most kernels that is
 * faster; the others are marked. No sum is reordered either way. */
#if defined(__GNUC__) && !defined(__clang__)
#define VECTORISED __attribute__((optimize("O3")))
#else
#define VECTORISED
#endif

#ifdef CHECK_INDICES
static int64_t index_of(int64_t i, int64_t size) {
    if (i < 0 || i >= size) {
        fprintf(stderr, "index %lld of %lld\n", (long long)i, (long long)size);
        abort();
    }
    return i;
}
#else
#define index_of(i, size) (i)
#endif
#define ITEM(a, i) ((a).at[index_of(i, (a).rows)])
#define CELL(a, i, j) ((a).at[index_of(i, (a).rows) * (a).width + index_of(j, (a).width)])

static inline Vector row_of(Matrix a, int64_t i) {
    return (Vector){a.at + index_of(i, a.rows) * a.width, a.width};
}
static inline Vector tail_of(Vector a, int64_t first) {
    return (Vector){a.at + index_of(first, a.rows + 1), a.rows - first};
}
/* What Python returns of two that are equal, or of NaN. */
static inline double min_float(double a, double b) { return b < a ? b : a; }
static inline double max_float(double a, double b) { return b > a ? b : a; }
static inline int64_t min_int(int64_t a, int64_t b) { return b < a ? b : a; }
static inline int64_t max_int(int64_t a, int64_t b) { return b > a ? b : a; }
static inline int64_t floor_mod(int64_t a, int64_t b) { int64_t r = a % b; return r < 0 ? r + b : r; }
static inline int64_t floor_div(int64_t a, int64_t b) { return (a - floor_mod(a, b)) / b; }
/* Python raises where there is no such number. */
static inline int64_t to_int(double x) { return x > -9e18 && x < 9e18 ? (int64_t)x : 0; }

typedef struct {
    void *at;
    int64_t rows, width, whole;
    double real;
} Argument;

typedef struct {
    const char *name, *letters;
    char returns;
    bool (*enter)(const Argument *, Argument *);
} Entry;

static inline Vector as_Vector(const Argument *a) { return (Vector){a->at, a->rows}; }
static inline Matrix as_Matrix(const Argument *a) { return (Matrix){a->at, a->rows, a->width}; }
static inline IntVector as_IntVector(const Argument *a) { return (IntVector){a->at, a->rows}; }
static inline IntMatrix as_IntMatrix(const Argument *a) {
    return (IntMatrix){a->at, a->rows, a->width};
}
static inline double as_float(const Argument *a) { return a->real; }
static inline int64_t as_int(const Argument *a) { return a->whole; }
static inline bool as_bool(const Argument *a) { return a->whole != 0; }

#include "kernels.c"

#define MOST_ARGUMENTS 32
#define CALL "ikservo.kernels.call"

/* An entry and its first arguments, which stay, and the objects that hold their memory. */
typedef struct {
    const Entry *entry;
    Py_ssize_t bound;
    Argument arguments[MOST_ARGUMENTS];
    PyObject *objects[MOST_ARGUMENTS];
} Call;

/* Take an array of 8-byte numbers in C order, of as many dimensions as its letter says. */
static bool take_array(const Entry *entry, Py_ssize_t i, PyObject *from, Argument *to) {
    char letter = entry->letters[i] | 0x20;
    int dimensions = letter == 'm' || letter == 'x' ? 2 : 1;
    bool whole = letter == 'w' || letter == 'x', written = letter != entry->letters[i];
    PyArrayObject *array = (PyArrayObject *)from;
    if (!PyArray_Check(from) || PyArray_NDIM(array) != dimensions || PyArray_ITEMSIZE(array) != 8 ||
        !(whole ? PyArray_ISSIGNED(array) : PyArray_TYPE(array) == NPY_DOUBLE)) {
        PyErr_Format(PyExc_TypeError, "%s: argument %zd is no array of %s with %d dimension(s)",
                     entry->name, i + 1, whole ? "int64" : "float64", dimensions);
        return false;
    }
    if (!(written ? PyArray_ISCARRAY(array) : PyArray_ISCARRAY_RO(array))) {
        PyErr_Format(PyExc_ValueError, "%s: argument %zd is not in C order%s", entry->name, i + 1,
                     written ? ", or read-only" : "");
        return false;
    }
    to->at = PyArray_DATA(array);
    to->rows = PyArray_DIM(array, 0);
    to->width = dimensions == 2 ? PyArray_DIM(array, 1) : 1;
    return true;
}

static bool take(const Entry *entry, Py_ssize_t i, PyObject *from, Argument *to) {
    switch (entry->letters[i]) {
    case 'f':
        to->real = PyFloat_AsDouble(from);
        return !PyErr_Occurred();
    case 'i':
        to->whole = PyLong_AsLongLong(from);
        return !PyErr_Occurred();
    case 'b':
        to->whole = PyObject_IsTrue(from);
        return to->whole >= 0;
    default:
        return take_array(entry, i, from, to);
    }
}

static PyObject *returned(const Entry *entry, const Argument *out) {
    switch (entry->returns) {
    case 'i': return PyLong_FromLongLong(out->whole);
    case 'b': return PyBool_FromLong((long)out->whole);
    case 'f': return PyFloat_FromDouble(out->real);
    default: Py_RETURN_NONE;
    }
}

static PyObject *call(PyObject *self, PyObject *const *given, Py_ssize_t count) {
    const Call *made = PyCapsule_GetPointer(self, CALL);
    if (made == NULL) return NULL;
    const Entry *entry = made->entry;
    Py_ssize_t bound = made->bound, all = (Py_ssize_t)strlen(entry->letters), taken = bound;
    Argument arguments[MOST_ARGUMENTS], out;
    if (bound + count != all) {
        return PyErr_Format(PyExc_TypeError, "%s: %zd arguments instead of %zd", entry->name,
                            bound + count, all);
    }
    memcpy(arguments, made->arguments, sizeof(Argument) * (size_t)bound);
    for (; taken < all; taken++) {
        if (!take(entry, taken, given[taken - bound], arguments + taken)) return NULL;
    }
    bool fits = false;
    Py_BEGIN_ALLOW_THREADS
    fits = entry->enter(arguments, &out);
    Py_END_ALLOW_THREADS
    if (fits) return returned(entry, &out);
    return PyErr_Format(PyExc_ValueError, "%s: the shapes of the arrays do not match", entry->name);
}

static void forget(PyObject *capsule) {
    Call *made = PyCapsule_GetPointer(capsule, CALL);
    for (Py_ssize_t i = 0; i < made->bound; i++) Py_DECREF(made->objects[i]);
    PyMem_Free(made);
}

static PyMethodDef CALLED = {"kernel", (PyCFunction)(void (*)(void))call, METH_FASTCALL, NULL};

PyDoc_STRVAR(bind_doc, "bind(name, *arguments): the kernel of that name with its first arguments.");

static PyObject *bind(PyObject *module, PyObject *const *given, Py_ssize_t count) {
    const Entry *entry = ENTRIES;
    PyObject *name = count > 0 ? PyUnicode_AsUTF8String(given[0]) : NULL;
    (void)module;
    if (name == NULL) {
        if (count == 0) PyErr_SetString(PyExc_TypeError, "bind() takes the name of a kernel");
        return NULL;
    }
    while (entry->name != NULL && strcmp(entry->name, PyBytes_AsString(name)) != 0) entry++;
    Py_DECREF(name);
    if (entry->name == NULL) return PyErr_Format(PyExc_KeyError, "%R", given[0]);
    Call *made = PyMem_Calloc(1, sizeof(Call));
    if (made == NULL) return PyErr_NoMemory();
    made->entry = entry;
    PyObject *capsule = PyCapsule_New(made, CALL, forget);
    if (capsule == NULL) {
        PyMem_Free(made);
        return NULL;
    }
    PyObject *function = NULL;
    if (count - 1 > (Py_ssize_t)strlen(entry->letters)) {
        PyErr_Format(PyExc_TypeError, "%s: too many arguments", entry->name);
    } else {
        while (made->bound < count - 1 &&
               take(entry, made->bound, given[made->bound + 1], made->arguments + made->bound)) {
            made->objects[made->bound] = Py_NewRef(given[made->bound + 1]);
            made->bound++;
        }
        if (made->bound == count - 1) function = PyCFunction_New(&CALLED, capsule);
    }
    Py_DECREF(capsule);
    return function;
}

static PyMethodDef METHODS[] = {
    {"bind", (PyCFunction)(void (*)(void))bind, METH_FASTCALL, bind_doc},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef MODULE = {
    PyModuleDef_HEAD_INIT, "_compiled", "Kernels, compiled; see docs/kernels.md.", -1, METHODS,
};

PyMODINIT_FUNC PyInit__compiled(void) {
    import_array();
    PyObject *module = PyModule_Create(&MODULE);
    if (module == NULL || PyModule_AddStringConstant(module, "SOURCES", SOURCES) < 0 ||
        PyModule_AddStringConstant(module, "DIGESTS", DIGESTS) < 0 ||
        PyModule_AddStringConstant(module, "BUILD_ID", BUILD_ID) < 0) {
        Py_XDECREF(module);
        return NULL;
    }
    return module;
}
