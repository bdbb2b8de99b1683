# SPDX-License-Identifier: Apache-2.0
"""Files: rigs, results, bags, recordings."""
