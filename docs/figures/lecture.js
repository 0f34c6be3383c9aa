// Fills each <figure class="interactive" data-figure="…"> of the page.

import { threeLinks, twoLinks } from "./closed_form.js";
import { ccd, nullSpace, pseudoInverse, transpose } from "./iterative.js";
import { picking } from "./picking.js";

const FIGURES = { twoLinks, threeLinks, pseudoInverse, nullSpace, transpose, ccd, picking };

for (const figure of document.querySelectorAll("figure[data-figure]")) FIGURES[figure.dataset.figure](figure);
