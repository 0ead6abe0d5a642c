/* Reads decisions from standard input, each an int (1 to begin with an empty memory) and the input, as they lie in
 * memory, and writes the status and the output of each. */
#include <stdio.h>
#include <string.h>

#include "policy.h"

int main(void)
{
    policy_input input;
    policy_output output;
    int begins, status;
#ifdef WITH_MEMORY
    policy_memory memory;
    memset(&memory, 0, sizeof memory);
#endif
    while (fread(&begins, sizeof begins, 1, stdin) == 1 && fread(&input, sizeof input, 1, stdin) == 1) {
#ifdef WITH_MEMORY
        if (begins) {
            memset(&memory, 0, sizeof memory);
        }
        status = policy_decide(&input, &memory, &output);
#else
        status = policy_decide(&input, &output);
#endif
        fwrite(&status, sizeof status, 1, stdout);
        fwrite(&output, sizeof output, 1, stdout);
    }
    return 0;
}
