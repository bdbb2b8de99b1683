# SPDX-License-Identifier: Apache-2.0
"""Files of a shoot, skeletons and keypoints, as one recording."""
