# SPDX-License-Identifier: Apache-2.0
"""Programs: thin shells around the other rooms."""
