// Compiles the policy with a number that counts what is done with it, in place of float, and tells the most operations
// of a decision: additions, multiplications, divisions, comparisons, functions. Reads what feed.c reads.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>

enum { ADD, MUL, DIV, CMP, FUN, KINDS };
static long counts[KINDS];

struct Counted {
    float v;
    Counted() = default;
    Counted(float x) : v(x) {}
    explicit operator int() const { return (int)v; }
    explicit operator double() const { return v; }
};
#define BINARY(op, kind) static Counted operator op(Counted a, Counted b) { counts[kind]++; return a.v op b.v; }
#define ASSIGN(op, kind) static Counted &operator op##=(Counted &a, Counted b) { counts[kind]++; a.v op##= b.v; return a; }
#define COMPARE(op) static bool operator op(Counted a, Counted b) { counts[CMP]++; return a.v op b.v; }
#define FUNCTION(name, kind) static Counted name(Counted a) { counts[kind]++; return ::name(a.v); }
#define FUNCTION2(name, kind) static Counted name(Counted a, Counted b) { counts[kind]++; return ::name(a.v, b.v); }
BINARY(+, ADD) BINARY(-, ADD) BINARY(*, MUL) BINARY(/, DIV)
ASSIGN(+, ADD) ASSIGN(-, ADD) ASSIGN(*, MUL) ASSIGN(/, DIV)
COMPARE(<) COMPARE(<=) COMPARE(>) COMPARE(>=) COMPARE(==)
static Counted operator-(Counted a) { counts[ADD]++; return -a.v; }
FUNCTION(fabsf, CMP) FUNCTION2(fminf, CMP) FUNCTION2(fmaxf, CMP)
FUNCTION(expf, FUN) FUNCTION(sqrtf, FUN) FUNCTION(ceilf, FUN) FUNCTION(floorf, FUN)
FUNCTION(cosf, FUN) FUNCTION(sinf, FUN) FUNCTION(asinf, FUN) FUNCTION2(atan2f, FUN)
static bool isfinite(Counted a) { counts[CMP]++; return std::isfinite(a.v); }

#define float Counted
#include "policy.c"
#undef float

int main()
{
    long most[KINDS] = {0};
    policy_input input;
    policy_output output;
    int begins;
#ifdef WITH_MEMORY
    policy_memory memory;
    std::memset((void *)&memory, 0, sizeof memory);
#endif
    while (std::fread(&begins, sizeof begins, 1, stdin) == 1 && std::fread((void *)&input, sizeof input, 1, stdin) == 1) {
        std::fill(counts, counts + KINDS, 0L);
#ifdef WITH_MEMORY
        if (begins) {
            std::memset((void *)&memory, 0, sizeof memory);
        }
        policy_decide(&input, &memory, &output);
#else
        policy_decide(&input, &output);
#endif
        for (int k = 0; k < KINDS; k++) {
            most[k] = std::max(most[k], counts[k]);
        }
    }
    std::printf("%ld %ld %ld %ld %ld\n", most[ADD], most[MUL], most[DIV], most[CMP], most[FUN]);
    return 0;
}
