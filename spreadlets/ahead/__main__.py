"""What the other processes run; with the name of a run alone, its list of kernels is written to standard output."""

import gc
import sys

from spreadlets.ahead import compile_entries, listed, record

if __name__ == "__main__":
    *runs, index, count = sys.argv[1:] if sys.argv[2:] else (*sys.argv[1:], "", "")
    if count:
        # These processes make little garbage, and end soon.
        gc.disable()
        compile_entries(listed(*runs)[::-1][int(index) :: int(count)])
    else:
        sys.stdout.write(record(*runs))
