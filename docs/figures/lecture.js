// Fills each <figure class="interactive" data-figure="…"> of the page.

import { threeLinks, twoLinks } from "./closed_form.js";
import { ccd, jointLimits, nullSpace, pseudoInverse, transpose } from "./iterative.js";
import { picking } from "./picking.js";
import { damping, forwardKinematics, jacobianColumns } from "./posture.js";

const FIGURES = {
  forwardKinematics, twoLinks, threeLinks, jacobianColumns, pseudoInverse, jointLimits, nullSpace, transpose, ccd,
  damping, picking,
};

for (const figure of document.querySelectorAll("figure[data-figure]")) FIGURES[figure.dataset.figure](figure);
