// Put in front of an exported policy, this makes of its numbers ones that count what is done with them, so that C++
// compiles it to a library that decides the same and tells how much it took: `operations` holds additions,
// multiplications, divisions, comparisons and functions, as nnql_bullet.exports.cost.Operations.
#include <cmath>

enum { ADD, MUL, DIV, CMP, FUN, KINDS };
extern "C" inline long operations[KINDS] = {};

template <class T> struct Counted {
    T v;
    Counted() = default;
    Counted(T x) : v(x) {}
    template <class U> explicit Counted(Counted<U> x) : v((T)x.v) {}
    explicit operator int() const { return (int)v; }
    explicit operator unsigned char() const { return (unsigned char)v; }

#define BINARY(op, kind) \
    friend Counted operator op(Counted a, Counted b) { operations[kind]++; return a.v op b.v; } \
    friend Counted &operator op##=(Counted &a, Counted b) { operations[kind]++; a.v op##= b.v; return a; }
#define COMPARE(op) \
    friend bool operator op(Counted a, Counted b) { operations[CMP]++; return a.v op b.v; }
#define FUNCTION(name, kind) \
    friend Counted name(Counted a) { operations[kind]++; return std::name(a.v); } \
    friend Counted name##f(Counted a) { operations[kind]++; return std::name(a.v); }
#define FUNCTION2(name, kind) \
    friend Counted name(Counted a, Counted b) { operations[kind]++; return std::name(a.v, b.v); } \
    friend Counted name##f(Counted a, Counted b) { operations[kind]++; return std::name(a.v, b.v); }
    BINARY(+, ADD) BINARY(-, ADD) BINARY(*, MUL) BINARY(/, DIV)
    COMPARE(<) COMPARE(<=) COMPARE(>) COMPARE(>=) COMPARE(==) COMPARE(!=)
    friend Counted operator-(Counted a) { operations[ADD]++; return -a.v; }
    FUNCTION(fabs, CMP) FUNCTION2(fmin, CMP) FUNCTION2(fmax, CMP)
    FUNCTION(exp, FUN) FUNCTION(sqrt, FUN) FUNCTION(ceil, FUN) FUNCTION(floor, FUN) FUNCTION(rint, FUN)
    FUNCTION(cos, FUN) FUNCTION(sin, FUN) FUNCTION(asin, FUN)
    FUNCTION2(atan2, FUN) FUNCTION2(hypot, FUN) FUNCTION2(fmod, FUN) FUNCTION2(copysign, CMP)
    friend bool isfinite(Counted a) { operations[CMP]++; return std::isfinite(a.v); }
};

typedef Counted<float> counted_float;
typedef Counted<double> counted_double;
#define float counted_float
#define double counted_double
extern "C" {
#include "policy.h"
#if __has_include("shield.h")
#include "shield.h"
#endif
}
